"""Wave analysis of pictures: waves of real frequencies and their groups, for FFTM masks and the detector frdft."""
