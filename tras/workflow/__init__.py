"""How the work is run: files, parameters, notebooks, caches, processes. Nothing here knows what a Koopman operator is.

Read `runner` (runs one notebook) and `staleness` (which notebooks are out of date) beside the Makefile; `study` computes the points of
a grid once each, in the processes of `executors`, kept by `cache`. `arguments` checks numbers and names for every room.
"""
