"""Large messages: serialized from whole arrays, and published without delaying other threads."""
