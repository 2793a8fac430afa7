"""Kernels only, from flat arrays and scalars to flat arrays. The calling packages contain the public wrappers."""
