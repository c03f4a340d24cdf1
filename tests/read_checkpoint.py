"""Prints a checkpoint as read by safetensors.numpy: one tab-separated line a tensor, then the values of `xi`."""

import sys

import numpy
from safetensors.numpy import load_file

tensors = load_file(sys.argv[1])
for name, values in sorted(tensors.items()):
    print("tensor", name, values.dtype, "x".join(map(str, values.shape)), sep="\t")
for term, equation in numpy.ndindex(tensors["xi"].shape):
    print("xi", term, equation, repr(float(tensors["xi"][term, equation])), sep="\t")
