"""A model as a torch module: f and heights, differentiable by points and by weights."""

from __future__ import annotations

from typing import Any

from ..arguments import whole_number
from ..decoder.model import Model
from ..errors import OptionError, require
from ..format.container import fold

torch: Any = require("torch", "encode")
Tensor: Any = torch.Tensor


class CndhfModule(torch.nn.Module):
    """The solid of a `Model` in torch: the same f, with autograd and on any device.

    The networks' weights are parameters, float32. Rotations, boxes, centre and scale are buffers. Centre and scale are
    float64: at a great distance from the origin, `module.float()` would move the solid. Changed weights do not go back
    into the model, because a file's weights are quantised.

    Parameters
    ----------
    model : Model
        Its weights are copied.

    Raises
    ------
    OptionError
        When it is no Model, or one of a surface: there are no networks then.

    Examples
    --------
    >>> import cndhf_codec, torch
    >>> from cndhf_codec.integrations.torch import CndhfModule
    >>> module = CndhfModule(cndhf_codec.load("tests/golden/encoded.cndhf"))
    >>> points = torch.tensor([[10.0, 5.0, 5.0], [3.0, 3.0, 3.0]], requires_grad=True)
    >>> (module(points) > 0).tolist()
    [True, False]
    """

    def __init__(self, model: Model) -> None:
        if not isinstance(model, Model):
            raise OptionError(f"a Model is needed; got {type(model).__name__}")
        if model.representation != "dhf":
            raise OptionError("the torch module is of double height fields; this file holds a surface")
        super().__init__()
        container = model.container
        self.register_buffer("centre", torch.tensor(container.centre, dtype=torch.float64))
        self.register_buffer("scale", torch.tensor(container.scale, dtype=torch.float64))
        self.dhfs = torch.nn.ModuleList(_DhfModule(record) for record in container.dhfs)

    def forward(self, points: Tensor) -> Tensor:
        """The implicit function f, as `Model.implicit`: positive inside, negative outside.

        Parameters
        ----------
        points : Tensor, shape (..., 3)
            In input coordinates.

        Returns
        -------
        Tensor, shape (...)
            In input units; float32, unless the module was made another type.

        Raises
        ------
        OptionError
            When points is not a tensor of that shape.

        Examples
        --------
        >>> import cndhf_codec, torch
        >>> from cndhf_codec.integrations.torch import CndhfModule
        >>> module = CndhfModule(cndhf_codec.load("tests/golden/encoded.cndhf"))
        >>> points = torch.tensor([[10.0, 5.0, 5.0]], requires_grad=True)
        >>> module(points).sum().backward()
        >>> points.grad.shape
        torch.Size([1, 3])
        """
        _check_tensor(points, 3)
        p = ((points.to(self.centre.dtype) - self.centre) / self.scale).to(self.dhfs[0].rotation.dtype)
        f = torch.stack([dhf(p) for dhf in self.dhfs]).amin(dim=0)
        return f * self.scale.to(f.dtype)

    def heights(self, i: int, uv: Tensor) -> Tensor:
        """Near and far height of a double height field over its plane, as `Model.heights`.

        Parameters
        ----------
        i : int
            Number of the double height field, from 0.
        uv : Tensor, shape (..., 2)
            Points of the plane, in the field's own frame, normalised units.

        Returns
        -------
        Tensor, shape (..., 2)
            Near and far height in the same frame.

        Raises
        ------
        OptionError
            When there is no field `i`, or uv is not a tensor of that shape.

        Examples
        --------
        >>> import cndhf_codec, torch
        >>> from cndhf_codec.integrations.torch import CndhfModule
        >>> module = CndhfModule(cndhf_codec.load("tests/golden/encoded.cndhf"))
        >>> near, far = module.heights(0, torch.tensor([0.5, 0.1]))
        >>> bool(near < far)
        True
        """
        i = whole_number(i, "the number of a DHF")
        if not 0 <= i < len(self.dhfs):
            raise OptionError(f"there is no DHF {i}; this model has {len(self.dhfs)}")
        _check_tensor(uv, 2)
        return self.dhfs[i].heights(uv.to(self.dhfs[i].bounds.dtype))


def _check_tensor(value: Any, n: int) -> None:
    if not isinstance(value, torch.Tensor):
        raise OptionError(f"a tensor of shape (..., {n}) is needed; got {type(value).__name__}")
    if value.shape[-1:] != (n,):
        raise OptionError(f"a tensor of shape (..., {n}) is needed; got {tuple(value.shape)}")


class _DhfModule(torch.nn.Module):
    """One double height field, in the normalised frame."""

    def __init__(self, record: Any) -> None:
        super().__init__()
        tensors = [torch.from_numpy(w.copy()) for w in record.weights()]
        self.matrices = torch.nn.ParameterList(tensors[0::2])
        self.biases = torch.nn.ParameterList(tensors[1::2])
        self.omegas = [float(record.omega_first)] + [float(record.omega_hidden)] * record.hidden_layers
        self.mirrors = record.mirrors
        self.register_buffer("rotation", torch.tensor(record.rotation, dtype=torch.float32))
        self.register_buffer("bounds", torch.tensor(record.bounds, dtype=torch.float32))

    def heights(self, uv: Tensor) -> Tensor:
        x = torch.clamp(uv, self.bounds[:2, 0], self.bounds[:2, 1])
        fold(x, self.mirrors)
        for W, b, omega in zip(self.matrices, self.biases, self.omegas, strict=False):
            x = torch.sin(omega * torch.nn.functional.linear(x, W, b))
        return torch.nn.functional.linear(x, self.matrices[-1], self.biases[-1])

    def forward(self, p: Tensor) -> Tensor:
        uvz = p @ self.rotation.T
        near, far = self.heights(uvz[..., :2]).unbind(dim=-1)
        z = uvz[..., 2]
        walls = torch.cat([uvz - self.bounds[:, 0], self.bounds[:, 1] - uvz], dim=-1).amin(dim=-1)
        return torch.minimum(torch.minimum(far - z, z - near), walls)
