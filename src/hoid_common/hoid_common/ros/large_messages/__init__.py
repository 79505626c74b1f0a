"""Large messages: serialized as whole arrays, and published without blocking other threads."""
