"""What to keep apart, and how to judge by it: multi-step error on trajectories that were not fitted."""

import numpy as np

from tras.recording import join

WINDOW = 501  # samples of a roll-out, at most


def hold_out(recording):
    """Every fifth trajectory apart, cut into windows of equal length: (the rest, those); all pairs stay in one of the two.

    With fewer than five trajectories each is cut first. (recording, None) if there is too little to hold anything out.
    """
    parts = recording if len(recording) >= 5 else recording.cut_all(max(2, -(-int(recording.lengths.max() - 1) // (5 + 1)) + 1))
    if len(parts) < 5 or np.median(parts.lengths) < 10:
        return recording, None
    fifth = np.arange(len(parts)) % 5 == 4
    lengths = parts.lengths[fifth]
    window = int(min(WINDOW, np.median(lengths)))
    whole, rest = parts[fifth].cut_all(window), parts[~fifth]
    full = whole.lengths == window
    leftover = [whole[~full]] if (~full).any() else []
    return join([rest, *leftover]), whole[full]


def multi_step_error(predicted, held, n):
    """Root mean square of roll-outs (samples, n', trajectories) against scaled trajectories; a sample counts 10 at most, NaN too."""
    error = np.abs(predicted[:, :n].transpose(2, 0, 1) - held.states[..., :n])
    return float(np.sqrt(np.mean(np.minimum(np.nan_to_num(error, nan=10.0), 10.0) ** 2)))
