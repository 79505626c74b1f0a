"""The publishers of the filter node.

No decision of the method belongs here.
"""
