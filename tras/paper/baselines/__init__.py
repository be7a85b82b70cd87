"""Other identification methods behind the same ``fit``, ``simulate`` and ``predict`` as `tras.KoopmanModel`.

Each file holds one method. All of them see channels scaled to [-1, 1] over the training data, keep to the boundaries of trajectories, start a roll-out from
the first state alone, and give NaN from where a prediction leaves the training data's range a thousandfold, as `KoopmanModel` does.
"""
