"""The exception family: every error this package raises on purpose is a `CndhfError`.

Messages are one line, name the file or the field, and say what to do where something can be done.
"""

from __future__ import annotations

import importlib
from types import ModuleType


class CndhfError(Exception):
    """Base of all errors raised on purpose by this package."""


class CndhfWarning(UserWarning):
    """What had to be assumed, and what a user should know of before trusting a result."""


class FormatError(CndhfError):
    """The bytes are not a valid `.cndhf` file. Base of the errors below."""


class SignatureError(FormatError):
    """The file does not start with the `.cndhf` signature."""


class TextModeError(SignatureError):
    """The signature shows that line endings or high bits were changed in transfer."""


class VersionError(FormatError):
    """The file's format version is not one this decoder reads."""


class TruncatedError(FormatError):
    """The file ends before the data that its header announces."""


class TrailingDataError(FormatError):
    """The file goes on after its checksum."""


class ChecksumError(FormatError):
    """The CRC-32 at the end of the file does not match the bytes before it."""


class FieldError(FormatError):
    """A header, record or metadata field holds a value outside its range."""


class LimitError(FormatError):
    """A count is larger than the format allows."""


class SectionError(FormatError):
    """A section is missing, repeated, of unknown mandatory kind or of unknown codec."""


class PayloadError(FormatError):
    """The compressed weight symbols cannot be decompressed to their announced size."""


class MeshError(CndhfError):
    """The input mesh cannot be read or does not describe a solid."""


class OptionError(CndhfError, ValueError):
    """An argument or option is outside its range."""


class InputError(CndhfError):
    """The input file cannot be opened or read."""


class OutputError(CndhfError):
    """The output cannot be written, or exists already."""


class SurfaceError(CndhfError):
    """No surface can be extracted at the resolution asked for."""


class EncodeError(CndhfError):
    """The encoder could not make a model of the mesh."""


class MissingExtraError(CndhfError, ImportError):
    """A library that belongs to an optional extra of this package is not installed."""


def require(module: str, extra: str) -> ModuleType:
    """Import `module`, or raise `MissingExtraError` naming the extra that brings it."""
    try:
        return importlib.import_module(module)
    except ImportError as exc:
        name = module.split(".")[0]
        raise MissingExtraError(
            f"this needs {name}, which is not installed; run: pip install 'cndhf-codec[{extra}]'"
        ) from exc
