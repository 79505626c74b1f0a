"""Fault injection: damaged files, wrong messages, killed processes; each case has an oracle.

`./hoid bench faults` runs the nightly number of cases, `--quick` a few. Cases repeat by seed.
"""
