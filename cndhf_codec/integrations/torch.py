"""A model as a differentiable module: heights and f on tensors, by points and by weights."""

from __future__ import annotations

from typing import Any

from ..decoder.model import Model
from ..errors import OptionError, require
from ..format.container import fold

torch: Any = require("torch", "encode")
Tensor: Any = torch.Tensor


class CndhfModule(torch.nn.Module):
    """The solid of a `Model` in torch: the same f, with autograd and on any device.

    The networks' weights are parameters, float32; rotations, boxes, centre and scale are buffers, the last two float64:
    far from the origin `module.float()` would move the solid. Changed weights do not go back into the model: a file's
    weights are quantised.
    """

    def __init__(self, model: Model) -> None:
        super().__init__()
        container = model.container
        self.register_buffer("centre", torch.tensor(container.centre, dtype=torch.float64))
        self.register_buffer("scale", torch.tensor(container.scale, dtype=torch.float64))
        self.dhfs = torch.nn.ModuleList(_DhfModule(record) for record in container.dhfs)

    def forward(self, points: Tensor) -> Tensor:
        """f at points (..., 3) of input coordinates -> (...,) in input units; as `Model.implicit`."""
        if points.shape[-1:] != (3,):
            raise OptionError(f"a tensor of shape (..., 3) is needed; got {tuple(points.shape)}")
        p = ((points.to(self.centre.dtype) - self.centre) / self.scale).to(self.dhfs[0].rotation.dtype)
        f = torch.stack([dhf(p) for dhf in self.dhfs]).amin(dim=0)
        return f * self.scale.to(f.dtype)

    def heights(self, i: int, uv: Tensor) -> Tensor:
        """(..., 2) -> (..., 2): near and far height of DHF `i`; as `Model.heights`."""
        if not 0 <= i < len(self.dhfs):
            raise OptionError(f"there is no DHF {i}; this model has {len(self.dhfs)}")
        if uv.shape[-1:] != (2,):
            raise OptionError(f"a tensor of shape (..., 2) is needed; got {tuple(uv.shape)}")
        return self.dhfs[i].heights(uv.to(self.dhfs[i].bounds.dtype))


class _DhfModule(torch.nn.Module):
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
