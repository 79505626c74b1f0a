"""The built-in strategies: rules for which objects are dynamic, and masks of their pixels."""
