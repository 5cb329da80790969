"""Compiled inner loops: arrays in, preallocated arrays out. They import nothing but ``starwise.constants``."""
