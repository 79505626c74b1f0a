"""What is remembered of an object besides its surface: colors, the best picture, its history."""
