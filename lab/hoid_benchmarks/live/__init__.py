"""Measurements of running nodes: processor time, memory, wake-ups and latency."""
