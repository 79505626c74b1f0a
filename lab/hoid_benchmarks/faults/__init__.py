"""The fault campaign: what is wrong, cut off, hostile or killed, by seed, each with an oracle.

`./hoid bench faults` runs it at nightly size, `--quick` a slice of it.
"""
