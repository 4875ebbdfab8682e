"""Bytes, files and streams -> models."""

from __future__ import annotations

import os
from pathlib import Path
from typing import BinaryIO

from .. import format as fmt
from ..arguments import bytes_like, path_like, whole_number
from ..errors import FormatError, InputError, LimitError, OptionError
from ..files import read_bytes
from ..format.constants import MAX_FILE_SIZE
from .limits import Limits
from .model import Model


def loads(data: bytes, limits: Limits | None = None) -> Model:
    """Read a model from the bytes of a `.cndhf` file.

    Takes at most 64 MiB of memory besides these bytes, and checks all of them.

    Parameters
    ----------
    data : bytes-like
        The whole file.
    limits : Limits, optional
        See `Model.limits`.

    Returns
    -------
    Model

    Raises
    ------
    FormatError
        When the bytes are not a valid file; the subclass says why.
    OptionError
        When an argument has another type.

    Examples
    --------
    >>> import cndhf_codec
    >>> from pathlib import Path
    >>> cndhf_codec.loads(Path("tests/golden/encoded.cndhf").read_bytes()).info["bytes"]
    747
    """
    data = bytes_like(data)
    return Model(fmt.loads(data), fmt.section_sizes(data), limits)


def loads_prefix(data: bytes, n_dhfs: int | None = None, limits: Limits | None = None) -> Model:
    """Read a model of the first double height fields from the first bytes of a file.

    For streams: call it again as bytes arrive, and `loads` in the end. The checksum comes last in a file, so damage may
    go unseen here. The fields come one after the other, and each of them only cuts: four files of two fields had their
    first after 49 to 54 % of the bytes, with a solid 3 to 41 % too large, and the whole after 99 %.

    Parameters
    ----------
    data : bytes-like
        The first bytes of a file whose weights have codec 2, which all presets but `paper` write.
    n_dhfs : int, optional
        How many double height fields; by default, as many as are complete.
    limits : Limits, optional
        See `Model.limits`.

    Returns
    -------
    Model
        Its solid contains that of the whole file.

    Raises
    ------
    TruncatedError
        When more bytes are needed.
    FormatError
        When the bytes are not the start of a valid file, or its weights can be read only as a whole.
    OptionError
        When the file does not have so many double height fields, or an argument has another type.

    Examples
    --------
    >>> import cndhf_codec
    >>> from pathlib import Path
    >>> data = Path("spec/vectors/accepted/rans.cndhf").read_bytes()
    >>> len(cndhf_codec.loads_prefix(data[:-4]).info["dhfs"])
    1
    >>> cndhf_codec.loads_prefix(data[:-10])
    Traceback (most recent call last):
    ...
    cndhf_codec.errors.TruncatedError: the file ends after 68 bytes, before DHF 0 is complete
    """
    n_dhfs = None if n_dhfs is None else whole_number(n_dhfs, "n_dhfs")
    return Model(fmt.loads_prefix(bytes_like(data), n_dhfs), limits=limits)


def load(path: str | os.PathLike[str], limits: Limits | None = None) -> Model:
    """Read a model from a `.cndhf` file.

    Parameters
    ----------
    path : str or path-like
        The file.
    limits : Limits, optional
        See `Model.limits`.

    Returns
    -------
    Model

    Raises
    ------
    FormatError
        When it is not a valid file; the message names the file, and the subclass says why.
    InputError
        When it cannot be read.
    OptionError
        When an argument has another type.

    Examples
    --------
    >>> import cndhf_codec
    >>> model = cndhf_codec.load("tests/golden/encoded.cndhf")
    >>> model.info["encoder"]
    '0.1.0'
    """
    return load_bytes(read_bytes(path_like(path), MAX_FILE_SIZE + 1), str(Path(path)), limits)


def load_stream(stream: BinaryIO, name: str, limits: Limits | None = None) -> Model:
    """Read a model from a binary stream, up to its end.

    Parameters
    ----------
    stream : binary file object
        Open for reading.
    name : str
        What messages call it.
    limits : Limits, optional
        See `Model.limits`.

    Returns
    -------
    Model

    Raises
    ------
    FormatError
        When the stream does not hold a valid file.
    InputError
        When it cannot be read.
    OptionError
        When it is not a binary stream, or another argument has another type.

    Examples
    --------
    >>> from cndhf_codec.decoder.reading import load_stream
    >>> with open("tests/golden/encoded.cndhf", "rb") as stream:
    ...     load_stream(stream, "the bracket").info["bytes"]
    747
    """
    try:
        data = stream.read(MAX_FILE_SIZE + 1)
    except OSError as exc:
        raise InputError(f"{name}: cannot be read: {exc.strerror}") from exc
    except (AttributeError, TypeError, ValueError) as exc:  # not a stream, a closed one, one of text
        raise OptionError(f"{name}: a stream is needed that is open for reading bytes") from exc
    return load_bytes(bytes_like(data), name, limits)


def load_bytes(data: bytes, name: str, limits: Limits | None = None) -> Model:
    """The same as `loads`, with errors that begin with a name."""
    try:
        if len(data) > MAX_FILE_SIZE:
            raise LimitError(f"the file has more than {MAX_FILE_SIZE} bytes, the most that the format allows")
        return loads(data, limits)
    except FormatError as exc:
        raise type(exc)(f"{name}: {exc}") from exc
