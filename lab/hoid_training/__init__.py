"""Training and evaluation of the synthetic detector, which is for rendered scenes."""
