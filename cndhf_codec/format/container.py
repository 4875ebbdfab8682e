"""The contents of a `.cndhf` file in memory: what the writer takes and the reader returns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from ..errors import OptionError
from . import constants as c

Symbols = npt.NDArray[np.int32]


def tensor_shapes(width: int, hidden_layers: int) -> list[tuple[int, ...]]:
    """Shapes of a network's tensors in file order: W0, b0, W1, b1, ..., output W, output b.

    A weight matrix has shape (outputs, inputs). 2 inputs, 1 + `hidden_layers` sine layers, 2 outputs.
    """
    shapes: list[tuple[int, ...]] = [(width, 2), (width,)]
    for _ in range(hidden_layers):
        shapes += [(width, width), (width,)]
    return [*shapes, (2, width), (2,)]


def parameter_count(width: int, hidden_layers: int) -> int:
    """Number of weights and biases of one network: 5 w^2 + 10 w + 2 for five hidden layers."""
    return hidden_layers * width * (width + 1) + 5 * width + 2


@dataclass(frozen=True, eq=False)
class DhfRecord:
    """One double height field as stored: small integers only.

    quaternion: (4,) int16, x y z w, `QUATERNION_ONE` stands for 1.
    box: (6,) int16, u v z bounds as min, max pairs, in units of `BOX_STEP`, in the rotated normalised frame.
    step_codes: one per tensor, 0 to 127; the quantisation step is 2^(-code / 4).
    symbols: one int32 array per tensor, in the shapes of `tensor_shapes`; |symbol| <= `MAX_SYMBOL`.
    fold: along which axes the heights are mirrored in the middle of the box: bit 0 for u, bit 1 for v.
    """

    quaternion: tuple[int, int, int, int]
    box: tuple[int, int, int, int, int, int]
    width: int
    hidden_layers: int
    omega_first: int
    omega_hidden: int
    step_codes: tuple[int, ...]
    symbols: tuple[Symbols, ...]
    fold: int = 0

    @property
    def rotation(self) -> npt.NDArray[np.float64]:
        """(3, 3) matrix R; R @ p takes a normalised point to this DHF's frame (u, v, z)."""
        return rotation_matrix(self.quaternion)

    @property
    def bounds(self) -> npt.NDArray[np.float64]:
        """(3, 2) minimum and maximum of u, v and z in the DHF's frame."""
        return np.array(self.box, dtype=np.float64).reshape(3, 2) * c.BOX_STEP

    @property
    def mirrors(self) -> tuple[float | None, float | None]:
        """The u and the v in which the heights are mirrored; None where they are not."""
        return mirrors(self.box, self.fold)

    @property
    def parameters(self) -> int:
        return parameter_count(self.width, self.hidden_layers)

    def weights(self) -> list[npt.NDArray[np.float32]]:
        """The dequantised tensors, float32, in the shapes of `tensor_shapes`."""
        return [(s * step_size(code)).astype(np.float32) for s, code in zip(self.symbols, self.step_codes, strict=True)]


@dataclass(frozen=True, eq=False)
class ControlMesh:
    """The control mesh of a subdivision surface as stored: integers, and the size of the grid.

    quaternion: (4,) int16, x y z w, as in `DhfRecord`; takes the normalised frame to that of the grid.
    step: normalised units per grid unit, a bfloat16 (`bfloat16.above`).
    positions: (V, 3) int32 grid coordinates, within 2^18. faces: (F, 3) int32 vertex numbers, a two-manifold with or
    without boundary. sharp: (S, 2) int32 interior edges that are sharp, the smaller vertex first, in lexicographic
    order; boundary edges are sharp and not listed.
    """

    quaternion: tuple[int, int, int, int]
    step: float
    positions: Symbols
    faces: Symbols
    sharp: Symbols

    @property
    def vertices(self) -> npt.NDArray[np.float64]:
        """(V, 3) positions in the normalised frame."""
        return (self.positions * float(self.step)) @ rotation_matrix(self.quaternion)


@dataclass(frozen=True)
class Metadata:
    """What the encoder says of a file. Errors are distances between the decoded and the input surface, in input units;
    the file holds bfloat16 that are not below them.

    mean_error: the mean error (CD), the mean of the mean distances from points of either surface to the other.
    p99_error, max_error: 99th percentile and maximum of the same distances.
    """

    encoder: str | None = None
    mean_error: float | None = None
    p99_error: float | None = None
    max_error: float | None = None
    source: str | None = None


@dataclass(frozen=True, eq=False)
class Container:
    """A whole file: double height fields, or a surface and none of them.

    A point p in input coordinates is (p - centre) / scale in the normalised frame. scale: a float32. centre: three
    float32 take 12 bytes less in the file. codec: `CODEC_ZSTD` or `CODEC_RANS`, of the weights. Raises OptionError for
    a container that holds both or neither.
    """

    centre: tuple[float, float, float]
    scale: float
    dhfs: tuple[DhfRecord, ...] = ()
    metadata: Metadata = field(default_factory=Metadata)
    codec: int = c.CODEC_ZSTD
    surface: ControlMesh | None = None

    def __post_init__(self) -> None:
        if (self.surface is None) == (not self.dhfs):
            raise OptionError("a container holds either double height fields or a surface")


def step_size(code: int) -> float:
    """Quantisation step of a step code: 2^(-code / 4)."""
    return 2.0 ** (-code / c.STEPS_PER_OCTAVE)


def mirrors(box: tuple[int, int, int, int, int, int], fold: int) -> tuple[float | None, float | None]:
    """The middle of the box in u and in v, each where its bit of `fold` is set, else None."""
    u, v = ((lo + hi) * c.BOX_STEP / 2 if fold >> k & 1 else None for k, (lo, hi) in enumerate((box[0:2], box[2:4])))
    return u, v


def fold(uv: Any, mirrors: Sequence[float | None]) -> None:
    """Move points (..., 2) in place to the side of the mirrors that the network describes.

    uv: a numpy array or a torch tensor.
    """
    for k, middle in enumerate(mirrors):
        if middle is not None:
            uv[..., k] = middle + abs(uv[..., k] - middle)


def rotation_matrix(quaternion: tuple[int, int, int, int]) -> npt.NDArray[np.float64]:
    """(3, 3) rotation matrix of an integer quaternion x y z w of any non-zero length."""
    q = np.array(quaternion, dtype=np.float64)
    x, y, z, w = q
    n = float(q @ q)
    # Dividing the integer products by the squared norm keeps the axis-aligned rotations exact.
    return (
        np.array(
            [
                [x * x - y * y - z * z + w * w, 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), -x * x + y * y - z * z + w * w, 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), -x * x - y * y + z * z + w * w],
            ]
        )
        / n
    )
