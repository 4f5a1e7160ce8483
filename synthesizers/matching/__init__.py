"""Compare patches with what surrounds them: at all places by Fourier transforms, near some by direct summation."""
