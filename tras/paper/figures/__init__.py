"""The figures of the paper and of the studies: tables in, `Figure` out. `tras.plotting` holds what they share."""
