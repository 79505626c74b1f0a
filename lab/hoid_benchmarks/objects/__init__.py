"""Objects of object maps of real recordings, compared with lists that were made by looking."""
