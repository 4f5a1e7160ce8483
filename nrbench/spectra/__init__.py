"""Wave analysis of images: waves of real-valued frequencies and their groups, for FFTM masks and the detector frdft."""
