"""Every compiled loop. Kernels take and fill bare C-contiguous arrays and scalars; each has a NumPy twin in the tests."""
