"""The errors: every exception that this package raises on purpose is a `CndhfError`.

Messages are one line. They name the file or the field, and say what to do when something can be done.

>>> import cndhf_codec
>>> try:
...     cndhf_codec.loads(b"no such file")
... except cndhf_codec.CndhfError as exc:
...     print(type(exc).__name__, exc)
SignatureError this is not a .cndhf file (wrong signature)
"""

from __future__ import annotations

import importlib
import importlib.util
from types import ModuleType


class CndhfError(Exception):
    """Base of all errors below: catch it to handle whatever this package raises on purpose."""


class CndhfWarning(UserWarning):
    """Warned when a result may not be what was wanted: an assumption about the input, thin walls lost, a fallback."""


class FormatError(CndhfError):
    """Base of the errors down to PayloadError, raised when bytes are not a valid `.cndhf` file."""


class SignatureError(FormatError):
    """Raised when a file does not start with the `.cndhf` signature: it is something else."""


class TextModeError(SignatureError):
    """Raised when the signature shows that a file was transferred as text."""


class VersionError(FormatError):
    """Raised when a file has a format version that this decoder does not read."""


class TruncatedError(FormatError):
    """Raised when a file, or a part of it, ends before what it announces."""


class ChecksumError(FormatError):
    """Raised when the CRC-32 at the end of a file does not match the bytes before it: it was damaged, or cut short."""


class FieldError(FormatError):
    """Raised when a field of the header, a record or the metadata holds a value outside its range."""


class LimitError(FormatError):
    """Raised when a count or a size is larger than the format allows, before anything of that size is allocated."""


class SectionError(FormatError):
    """Raised when a section is missing, repeated, too short, or of an unknown kind."""


class PayloadError(FormatError):
    """Raised when the compressed weights cannot be decompressed to as many symbols as the records need."""


class MeshError(CndhfError):
    """Raised when an input mesh cannot be read, or does not describe a solid."""


class OptionError(CndhfError, ValueError):
    """Raised when an argument or an option has a wrong type or value; a ValueError, too."""


class InputError(CndhfError):
    """Raised when an input file cannot be opened or read."""


class OutputError(CndhfError):
    """Raised when an output cannot be written, or exists and may not be overwritten."""


class SurfaceError(CndhfError):
    """Raised when no surface can be made: the solid is empty or too thin for the resolution, or beyond the limits."""


class SheetError(CndhfError):
    """Raised when something needs an inside, and the file holds a sheet: a surface that encloses nothing."""


class EncodeError(CndhfError):
    """Raised when the encoder cannot make a model of a mesh."""


class MissingExtraError(CndhfError, ImportError):
    """Raised when a library is not installed that an optional extra of this package brings; an ImportError, too."""


def first_line(exc: Exception) -> str:
    """What an exception says, in one line: its first, or the name of its type.

    >>> from cndhf_codec.errors import first_line
    >>> first_line(ValueError("no number\\n  at line 3")), first_line(EOFError())
    ('no number', 'EOFError')
    """
    text = str(exc).strip().splitlines()
    return text[0] if text else type(exc).__name__


def require(module: str, extra: str) -> ModuleType:
    """Import a module, or raise MissingExtraError with the extra that brings it.

    >>> from cndhf_codec.errors import require
    >>> require("numpy", "mesh").__name__
    'numpy'
    """
    try:
        return importlib.import_module(module)
    except ImportError as exc:
        raise _missing(module, extra) from exc


def require_all(modules: tuple[str, ...], extra: str) -> None:
    """Raise MissingExtraError where one of these modules is not installed. Imports none: some take half a second.

    >>> from cndhf_codec.errors import require_all
    >>> require_all(("numpy", "zstandard"), "mesh")
    """
    for module in modules:
        if importlib.util.find_spec(module) is None:
            raise _missing(module, extra)


def _missing(module: str, extra: str) -> MissingExtraError:
    name = module.split(".")[0]
    return MissingExtraError(
        f"this needs {name}, which is not installed; run, in a checkout of cndhf-codec: pip install '.[{extra}]'"
    )
