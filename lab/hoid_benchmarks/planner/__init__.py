"""A small planner among simulated people, with and without the masks for Nav2's filters."""
