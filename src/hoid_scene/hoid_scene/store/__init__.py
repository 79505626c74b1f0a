"""The scene in databases: in map files, and in one from which a killed node resumes."""
