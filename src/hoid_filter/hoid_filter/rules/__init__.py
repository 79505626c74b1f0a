"""What makes an object dynamic (the strategies), and which features lie on it.

Nothing here finds or describes features.
"""
