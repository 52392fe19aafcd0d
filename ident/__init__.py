"""A plan becomes measurements, measurements become alpha, and what alpha cannot explain becomes a named effect."""
