"""Other identification methods behind the same ``fit``, ``simulate`` and ``predict`` as `tras.KoopmanModel`.

Each file holds one method, `base` what they share. All see channels scaled to [-1, 1] over the training data, keep to
the boundaries of trajectories, start a roll-out from the first state, and give NaN from where a prediction leaves the
range of the training data a thousandfold, as `KoopmanModel` does.
"""
