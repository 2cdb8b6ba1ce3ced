"""Rigid motions on scalars that may be floats, arrays, tracers or balls; knows no robot."""
