"""The suite's errors: one line each, naming what is at fault and what to do about it."""


class HoidError(Exception):
    """Base of all errors that a user can cause and mend."""


class InputError(HoidError):
    """A file, recording or bag cannot be used."""


class ConfigError(HoidError):
    """A parameter or option has an unusable value."""


class MessageError(HoidError):
    """A message contradicts itself or the camera (array lengths, encodings, sizes)."""


class ModelError(HoidError):
    """A detector model cannot be found, read or understood."""


class NoModelError(ModelError):
    """No detector model is here, and none was asked for; motion tells what moves without one."""


class MapFileError(HoidError):
    """A map file is truncated, foreign, hostile or of another version."""
