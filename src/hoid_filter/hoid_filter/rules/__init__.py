"""What makes an object dynamic: the strategies, the paper's rules among them.

Nothing here touches features.
"""
