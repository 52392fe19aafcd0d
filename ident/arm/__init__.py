"""The whole arm as one linear system: all motors, all records, known effects, and the maximum-likelihood fit of it."""
