"""Numba kernels, and nothing else: flat arrays and scalars in, flat arrays out. The public wrappers stand in the stages."""
