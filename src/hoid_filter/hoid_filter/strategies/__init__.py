"""The built-in strategies: rules that classify objects as dynamic, and masks of their pixels."""
