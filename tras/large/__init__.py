"""Recordings larger than memory: what they are, and a fit that reads them in pieces.

Read `slices` first (files, datasets and streams of pieces), then `streaming` (the fit), `checkpoint` (going on after an
interruption) and `distributed` (many workers).
"""
