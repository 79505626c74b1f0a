"""A rendered scene with people who handle objects, with exact truth about everything."""
