"""The memory of an object besides its surface: its colors, best picture and history."""
