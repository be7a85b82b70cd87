"""The figures of the paper (`paper`, `drawings`) and of the studies; `tras.plotting` holds what they share."""
