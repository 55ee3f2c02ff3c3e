"""Every compiled loop. Kernels take and fill bare C-contiguous arrays and scalars; the tests have a twin of each."""
