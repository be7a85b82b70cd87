"""How the work is run: files, parameters, notebooks, caches, processes. Nothing here knows what a Koopman operator is.

Read `runner` (runs one notebook) and `staleness` (which are out of date) beside the Makefile. `study` computes each
point of a grid once, by `executors` and `processes`, and stores it by `cache`. `environment` is what a build takes from
the shell that starts it. `arguments` checks numbers and names.
"""
