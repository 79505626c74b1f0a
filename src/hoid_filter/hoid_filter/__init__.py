"""The HOID filter: which image features lie on people and on the objects they handle."""
