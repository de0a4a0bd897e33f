"""Compiled inner loops: the decorator of kernels, and BLAS and LAPACK inside them."""
