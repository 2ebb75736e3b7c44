"""The table of numpy idioms: each computes in a traced model what numpy computes, or is refused.

The code is an expression of an input x (4,), the time t and constants, or statements that end in `return`. The page
"numpy that can be traced" is generated from this table, and the tests run every row.
"""

from __future__ import annotations

import math
import textwrap
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

Expected = Literal["equal", "refused"]


@dataclass(frozen=True)
class Idiom:
    """One row of the table."""

    kind: str
    code: str
    expected: Expected

    @property
    def function(self) -> Callable[[Any, Any], Any]:
        """The code as a function of x and t, with a fresh set of what it may keep."""
        return _compiled("def f(x, t):\n" + textwrap.indent(_body(self.code), "    "), self.kind)


def _body(code: str) -> str:
    return code if "return" in code else f"return {code}"


def _compiled(source: str, name: str) -> Callable[[Any, Any], Any]:
    namespace: dict[str, Any] = {
        "np": np,
        "C": np.array([0.5, -1.0, 2.0, 0.25]),
        "M": MATRIX,
        "kept": [],
        "time": time,
        "math": math,
    }
    exec(compile(source, f"<{name}>", "exec"), namespace)
    function: Callable[[Any, Any], Any] = namespace["f"]
    return function


def composed(idioms: Sequence[Idiom]) -> Idiom:
    """Idioms one after the other: each takes what the one before gives, as four elements."""
    parts = [
        f"def part_{i}(x, t):\n"
        + textwrap.indent(_body(idiom.code), "    ")
        + f"\nx = np.resize(part_{i}(x, t), (4,)) * 1.0"
        for i, idiom in enumerate(idioms)
    ]
    return Idiom("composed", "\n".join([*parts, "return x"]), "equal")


MATRIX = np.array([[2.0, 1.0, 0.0, 0.5], [0.0, 3.0, -1.0, 0.0], [1.0, 0.0, 2.0, 0.0], [0.0, 0.25, 0.0, 1.0]])

_EQUAL = {
    "arithmetic": """
        x + C
        C - x
        2 * x
        x / (x * x + 1.0)
        -x
        +x
        x**2
        x**3
        x**-1
        x**0.5
        np.abs(x)**1.7
        2.0**x
        abs(x)
        x // 0.7
        x % 0.7
        x % -0.7
        np.fmod(x, 0.7)
        np.mod(x, C)
        np.stack(divmod(x[0], 0.4))
        np.remainder(x, 1.5)
        np.reciprocal(x)
        np.square(x)
        np.float_power(np.abs(x), 1.5)
        np.negative(x)
        np.positive(x)
        x * t + np.sin(t)
        pow(x, 2)
        1 / x
        x[0] + x[1] * x[2] - x[3]
    """,
    "elementary functions": """
        np.sin(x)
        np.cos(x)
        np.tan(x)
        np.arcsin(x / 10.0)
        np.arccos(0.9 * np.tanh(x))
        np.arctan(x)
        np.arctan2(x, C)
        np.hypot(x, C)
        np.sinh(x)
        np.cosh(x)
        np.tanh(x)
        np.arcsinh(x)
        np.arccosh(1.0 + x * x)
        np.arctanh(np.sin(x) * 0.9)
        np.exp(-x * x)
        np.expm1(x)
        np.log(np.abs(x) + 1.0)
        np.log1p(x * x)
        np.log2(np.abs(x) + 0.5)
        np.log10(np.abs(x) + 0.5)
        np.exp2(np.tanh(x))
        np.sqrt(np.abs(x))
        np.cbrt(x)
        np.deg2rad(x)
        np.rad2deg(x)
        np.degrees(x)
        np.radians(x)
        np.sinc(x)
        np.logaddexp(x, C)
    """,
    "rounding": """
        np.floor(x)
        np.ceil(x)
        np.trunc(x)
        np.rint(x)
        np.round(x)
        np.round(x, 1)
        np.round(t, 1) * x
        np.around(x, 2)
        np.fix(x)
        x.round()
        x.astype(int)
        x.astype(int) * 1.0
        np.stack([round(x[0]), round(x[1])])
        math.floor(x[0]) + 0.5 * x
        math.ceil(x[0]) + 0.5 * x
        np.floor(x / 0.1) * 0.1
        x - np.floor(x)
    """,
    "as it is written": """
        (x + 1e16) - 1e16
        (x + C) - C
        C - (x + C)
        (x - C) + C
        5.0 * (0.2 * x) - x
        (x / C) * C - x
        (x * C) / C - x
        x * (1.0 / C) - x / C
        x - x
        0.0 * x + x
        np.where(x / x == 1.0, x, 0.0)
        np.sqrt(x)**2
        np.where(np.isnan(np.sqrt(x)**2), 5.0, x)
        np.sqrt(x)
        y = np.sqrt(x)\\nreturn np.where(y == y, y, -1.0)
        y = np.sqrt(x)\\nreturn np.where(y != y, 1.0, y)
        np.sqrt(x * x)
        np.log(np.exp(300.0 * x))
        np.exp(np.log(x))
        np.log(np.exp(1e-9 * x))
        np.sin(x)**2 + np.cos(x)**2 - 1.0
        s, c = 1e10, 0.0\\nfor v in x:\\n    z = s + (v - c)\\n    c = (z - s) - (v - c)\\n    s = z\\nreturn s - 1e10
        0.5 * x + 0.5 * x
        x**0
        np.zeros(4)**0 * x
        x**1
        0.0**np.abs(x)
        1.0**x
        1.0 / (1.0 / x)
        np.where(x == 1.0, 1.0, x / (x - 1.0))
        np.copysign(0.0, x) + x
        x * 1.0 / 1.0 - 0.0
        -(-x)
        (-x) * (-C)
        -x - (-C)
        (-x) / C
        C / (-x)
    """,
    "limits and signs": """
        np.clip(x, -0.5, 0.5)
        x.clip(-0.5, 0.5)
        x.clip(min=0.0)
        np.clip(x, None, 1.0)
        np.minimum(x, C)
        np.maximum(x, C)
        np.fmin(x, C)
        np.fmax(x, np.sqrt(np.abs(C)))
        np.maximum(x, np.sqrt(x))
        np.fmax(np.sqrt(x), 0.0)
        np.sign(x)
        np.copysign(C, x)
        np.heaviside(x, 0.5)
        np.abs(x)
        np.fabs(x)
        np.signbit(x) * 1.0
        np.maximum(0.0, x)
        np.nan_to_num(C) * x
    """,
    "comparisons and Booleans": """
        np.where(x > 0, x, -2.0 * x)
        np.where(x[0] > 5e4, 1.0, x)
        np.where((x > 0) & (x < 1), x, 0.0)
        np.where((x < 0) | (x > 1), x, 0.0)
        np.where(~(x > 0), x, 0.0)
        np.where((x > 0) ^ (x > 1), x, 0.0)
        np.where(np.logical_and(x > 0, x < 1), 1, 2)
        np.where(np.logical_or(x > 0, x < -1), 1.0, 2.0)
        np.where(np.logical_not(x > 0), 1.0, 2.0)
        np.where(np.logical_xor(x > 0, x > 1), 1.0, 2.0)
        (x > 0) + (x > 1) + (x > 2)
        (x > 0) * (x > 1)
        (x > 0) * 1.0
        1.0 * (x > 0) + 1.0 * (x > 1)
        (x > 0) * x
        (x > 0) == (x > 1)
        x == 0.0
        x != 2.5
        x >= C
        x <= C
        (x > 0).astype(float)
        (x > 0).astype(int)
        np.sum(x > 0)
        (x > 0).sum()
        np.mean(x > 0)
        np.any(x > 2)
        np.all(x > -2)
        (x > 2).any()
        (x > -5).all()
        np.count_nonzero(x > 0)
        np.count_nonzero(x)
        np.select([x > 1, x > 0], [x, 2.0 * x], -1.0)
        np.piecewise(x, [x < 0, x >= 0], [lambda v: -v, lambda v: v * v])
        np.isnan(x)
        np.isfinite(x) * x
        np.where(np.isnan(np.sqrt(x)), 0.0, x)
        np.isclose(x, 0.3)
        np.where(x > 0, np.sqrt(np.abs(x)), 0.0)
        np.where(np.array([True, False, True, False]), x, 0.0)
        max(1.0, 2.0) * x
        np.random.default_rng(3).normal(size=4) * x
        np.random.RandomState(1).rand(4) + x
        x * (True if len(x) == 4 else False)
    """,
    "Boolean masks": """
        np.sum(x[x > 0])
        x[x > 0].sum()
        np.prod(x[x > 0])
        np.mean(x[x > -1e9])
        d = x * 1.0\\nd[x < 0] = 0\\nreturn d
        d = x.copy()\\nd[x > 1] = 1.0\\nreturn d
        d = x.copy()\\nd[x < 0] *= -1\\nreturn d
        d = x.copy()\\nm = x > 0\\nd[m] = x[m] ** 2\\nreturn d
        d = np.zeros(4)\\nd[x > 0] = C[0]\\nreturn d
        d = np.zeros(4)\\nm = x > 0\\nd[m] = np.sqrt(x[m])\\nreturn d
        d = x.copy()\\nd[np.array([True, False, True, False])] = 0.0\\nreturn d
        x[np.array([True, False, True, False])]
        d = np.outer(x, x)\\nd[d > 1] = 1\\nreturn d.ravel()
        d = x.copy()\\nd[~(x > 0)] = -1\\nreturn d
        np.any(x[x > 0] > 1)
        x[x > 0].size * x
        d = x.copy()\\nd[d < 0] += 3.0\\nreturn d
    """,
    "indices and slices": """
        x[1:]
        x[::-1]
        x[::2]
        x[-1] * x
        x[[0, 2]]
        x[np.array([3, 1, 0])]
        x[..., 0] + x[1:]
        x[:, None][:, 0]
        (x[:, None] * x[None, :]).ravel()
        x[np.newaxis, :][0]
        np.outer(x, C)[1]
        np.take(x, [0, 3])
        x.take([1, 2])
        np.stack([v * 2.0 for v in x])
        np.stack([i * v for i, v in enumerate(x)])
        a, b, c, d = x\\nreturn np.stack([a + b, c - d])
        first, *rest = x\\nreturn np.stack([first, sum(rest)])
        x.reshape(2, 2)[1]
        x.reshape((2, 2)).T.ravel()
        np.flip(x)
        np.roll(x, 1)
        x[len(x) // 2] * x
    """,
    "writes": """
        d = np.zeros(4)\\nd[0] = x[1]\\nd[1] = -x[0]\\nreturn d
        d = np.zeros_like(x)\\nd[1:] = x[:-1]\\nreturn d
        d = np.empty(2)\\nd[0] = x[0]\\nd[1] = x[1]\\nreturn d
        d = np.ones(4)\\nd[2] += x[2]\\nreturn d
        d = np.full(4, 3.0)\\nd[:2] = x[2:]\\nreturn d
        d = np.eye(2)\\nd[0, 1] = x[0]\\nreturn d @ x[:2]
        d = x.copy()\\nd += 1.0\\nreturn d
        d = x.copy()\\nd *= C\\nreturn d
        d = x.copy()\\nd /= 2.0\\nreturn d
        d = x.copy()\\nd -= d[::-1]\\nreturn d
        d = x.copy()\\nd **= 2\\nreturn d
        d = x * 1.0\\nv = d[1:]\\nv[0] = 5\\nreturn d
        d = x * 1.0\\nv = d[1:]\\nv += 1.0\\nreturn d
        d = x * 1.0\\ny = d\\ny += x\\nreturn d
        d = x * 1.0\\ny = d.reshape(2, 2)\\ny[0] = 0.0\\nreturn d
        d = x * 1.0\\nd[0], d[1] = d[1], d[0]\\nreturn d
        d = x * 1.0\\nd[:2], d[2:] = d[2:], d[:2]\\nreturn d
        d = x * 1.0\\nd[[0, 3]] = d[[3, 0]]\\nreturn d
        d = x * 1.0\\nd[[0, 2]] += 1.0\\nreturn d
        d = x[::-1].copy()\\nd[0] = t\\nreturn d
        s = x[0]\\ns += 1.0\\nreturn s * x
        d = np.zeros((2, 2))\\nd[0] = x[:2]\\nd[:, 1] = x[2:]\\nreturn d.ravel()
        d = np.array([x[0], 0.0, 1.0])\\nd[1] = x[1]\\nreturn d
        d = x * 1.0\\nd.fill(2.0)\\nreturn d + x
        d = np.zeros(3)\\nfor i in range(3):\\n    d[i] = x[i + 1] - x[i]\\nreturn d
        d = np.zeros(4)\\nnp.add(x, C, out=d)\\nreturn d
        d = np.array(C)\\nd[0] = x[0]\\nreturn d
        d = x.ravel().copy()\\nd[1] = 0\\nreturn d
        d = np.zeros(4, dtype=int)\\nreturn x + d
        d = np.zeros(4)\\ne = d + 1.0\\ne[0] = x[0]\\nreturn e
    """,
    "making arrays": """
        np.array([x[0], 0.0, x[1]])
        np.array([x[0] * 2, 1])
        np.asarray(x) * 2
        np.array(x) + 1
        [x[0], x[1] * 2.0]
        (x[0], x[1])
        np.stack([x[0], x[3]])
        np.concatenate([x, [1.0, 2.0]])
        np.concatenate((x[:2], C))
        np.hstack([x, 1.0])
        np.vstack([x, C]).ravel()
        np.column_stack([x, C])[0]
        np.append(x, 3.0)
        np.append(x, [x[0], 1.0])
        np.append([x[0], 1.0], x)
        np.insert(x, [1, 2], [x[3], x[0]])
        np.concatenate([x[:1], [x[1], t]])
        np.r_[C, 1.0][:4] * x
        np.block([[np.diag(x[:2]), np.zeros((2, 2))]]).ravel()
        np.tile(x, 2)
        np.repeat(x, 2)
        np.insert(x, 1, 0.0)
        np.delete(x, 0)
        np.diag(x) @ C
        np.diagonal(np.outer(x, C))
        np.atleast_1d(x[0])
        np.pad(x, 1)
        np.full(3, x[0])
        np.zeros(4) + x
        np.linspace(0.0, 1.0, 4) * x
        np.arange(4) * x
        np.array([[x[0], x[1]], [x[2], x[3]]]) @ C[:2]
        np.full_like(x, 2.0) * x
        np.ones_like(x) - x
        np.concatenate([*np.split(x, 2)])
        np.expand_dims(x, 0)[0]
        np.squeeze(x.reshape(1, 4))
        np.tril(np.outer(x, x)).ravel()
        np.broadcast_to(x[0], (3,))
    """,
    "sums and products": """
        np.sum(x)
        x.sum()
        sum(x)
        np.prod(x)
        np.mean(x)
        x.mean()
        np.var(x)
        np.std(x)
        np.std(x, ddof=1)
        np.average(x, weights=[1.0, 2.0, 3.0, 4.0])
        np.cumsum(x)
        np.cumprod(x)
        np.diff(x)
        np.max(x)
        np.min(x)
        x.max()
        x.min() + x
        np.ptp(x)
        np.argmax(x)
        x.argmin() * 1.0
        np.sort(x)
        np.sum(np.outer(x, x), axis=0)
        np.outer(x, x).sum(axis=1)
        np.max(x.reshape(2, 2), axis=0)
        np.mean(x.reshape(2, 2), axis=1, keepdims=True).ravel()
        np.add.reduce(x)
        np.maximum.reduce(x)
        np.add.accumulate(x)
        np.multiply.outer(x, C)[0]
        np.trapezoid(x)
        np.trapezoid(x, dx=0.1)
        np.convolve(x, [1.0, 2.0])
        np.polyval([1.0, 2.0, 3.0], x)
        np.polyval(x, 0.5)
    """,
    "linear algebra": """
        M @ x
        x @ M
        x @ C
        x.dot(C)
        np.dot(M, x)
        np.inner(x, C)
        np.vdot(x, C)
        np.outer(x, x) @ x
        np.matmul(M, x)
        np.einsum("ij,j->i", M, x)
        np.einsum("i,i->", x, C)
        np.tensordot(M, x, axes=1)
        np.kron(x[:2], C[:2])
        np.cross(x[:3], C[:3])
        np.trace(np.outer(x, C))
        np.transpose(M) @ x
        np.linalg.norm(x)
        np.linalg.norm(x, 1)
        np.linalg.norm(x, np.inf)
        np.linalg.norm(x.reshape(2, 2), axis=1)
        np.linalg.solve(M, C) * x
        np.linalg.solve(M, x)
        np.linalg.inv(M) @ x
        np.linalg.det(np.diag(x[:2]) + np.eye(2) * 10.0)
        np.linalg.inv(np.diag(x[:2] ** 2) + np.eye(2)) @ x[:2]
        np.linalg.solve(np.diag(x ** 2) + M.T @ M, x)
        np.eye(4) @ x
        x.T @ M @ x
        np.linalg.matrix_power(np.diag(x[:2]), 2).ravel()
    """,
    "tables": """
        np.interp(x, [-1.0, 0.0, 2.0], [3.0, 1.0, -1.0])
        np.interp(x[0], [0.0, 1.0], [2.0, 5.0])
        np.interp(x, [-1.0, 0.0, 2.0], [3.0, 1.0, -1.0], left=0.0, right=9.0)
        np.interp(x, [-1.0, 0.0, 2.0], [3.0, 1.0, -1.0], right=9.0)
        np.interp(x, [0.0, 1.0, 2.0], [3.0, 1.0, 5.0], period=3.0)
        np.interp(x, [0.0, 1.0, 2.0], [x[0], 1.0, x[1]])
        np.searchsorted([-1.0, 0.0, 0.5], x)
        np.searchsorted(C[[1, 3, 0, 2]], x, side="right")
        np.digitize(x, [-1.0, 0.0, 0.5])
        np.digitize(x, [-1.0, 0.0, 0.5], right=True)
        np.digitize(x, [0.3, 0.1, -1.0])
        np.digitize(x, [0.3, 0.3, -1.0], right=True)
    """,
    "branches on types and shapes": """
        x if isinstance(x, np.ndarray) else 0.0 * x
        x[0] * x if isinstance(x[0], float) else x
        x if x.dtype == float else 2.0 * x
        x if x.dtype.kind == "f" else 2.0 * x
        x * x.ndim + x.size + x.shape[0]
        x * np.ndim(x) + np.size(x)
        x if np.isscalar(t) else 2.0 * x
        x if hasattr(x, "T") else 2.0 * x
        x.real + np.real(x)
    """,
    "kept signs of zeros": """
        np.signbit(np.where(x > 5, 1.0, x)) * 1.0
        d = x.copy()\\nd[x > 9] = 1.0\\nreturn np.signbit(d) * 1.0
        np.signbit(np.sign(x)) * 1.0
        np.arctan2(np.sign(x), -1.0)
        np.signbit(np.where(x > 0, 0.0, x)) * 1.0
        np.copysign(1.0, x // 0.5)
    """,
    "lists of numbers": """
        np.max([x[0], x[1]])
        np.min((x[0], 0.0)) * x
        np.sum([x[0], x[1]])
        np.mean([x[0], 2.0, x[1]])
        np.sum([x > 0, x > 1], axis=0)
        np.linalg.norm([x[0], x[1], 1.0])
        np.any([x[0] > 0, x[1] > 0]) * x
        np.sort([x[1], x[0]])
        np.median([x[1], x[0], 0.5])
        d = x.copy()\\nm = (d > 0) & (d < 2)\\nd[m] = d[m] * np.array(C)[m]\\nreturn d
    """,
    "reductions with options": """
        np.sum(x, where=x > 0)
        np.sum(x, initial=5.0)
        np.max(x, initial=0.0)
        np.mean(x, where=x > 0)
        np.max(x, initial=0.0, where=x < 1)
        np.median(x)
        np.apply_along_axis(np.sum, 0, x)
        np.linspace(0.0, x[0], 3)
        x // 2 + np.int64(3) // (x > 0).sum()
    """,
    "Boolean masks, further": """
        d = x.copy()\\nd[(x > 0) | (x < -1)] = t\\nreturn d
        m = np.zeros(4, dtype=bool)\\nm[0] = True\\nreturn np.where(m, x, -x)
        m = x > 0\\nm[0] = False\\nreturn np.where(m, x, 7.0)
        d = x.reshape(2, 2).copy()\\nd[d > 0] = 0\\nreturn d.ravel()
        d = x.reshape(2, 2).copy()\\nd[d[:, 0] > 0] = 0\\nreturn d.ravel()
        d = x.copy()\\nnp.putmask(d, x > 0, 0.0)\\nreturn d
        np.where(x > 0, *(x, -x))
        x[~np.isnan(x)].sum()
        x[[True, False, True, True]]
        np.sum((x > 0).astype(int) * 2 - 1)
        np.sum(x > 0) // 2
        (x > 0).mean()
        np.cumsum(x > 0)
        (x > 0) @ x
        np.sum(x * (x > 0), where=[True, True, False, True])
    """,
    "views and writes, further": """
        d = np.outer(x, x)\\nd.T[0] = 0\\nreturn d[:, 0] + d[1]
        d = x * 1.0\\nd.flat[2] = 4\\nreturn d
        d = x * 1.0\\na, b = np.split(d, 2)\\na[0] = 2\\nreturn d
        d = x * 1.0\\nv = np.reshape(d, (2, 2), order="F")\\nreturn v.ravel()
        np.ravel(x.reshape(2, 2), order="F")
        x.reshape(2, -1).T.reshape(-1)
        x.reshape(2, 2).T.flatten(order="K")
        d = x.reshape(2, 2).copy()\\nfor row in d:\\n    row += 1\\nreturn d.ravel()
        d = x[:]\\nd = d + 1\\nreturn d
        d = x.copy()\\nd[[0, 0, 1]] += 1.0\\nreturn d
        d = x.copy()\\nd[:] = 0\\nd[1] = x[2]\\nreturn d
        d = np.arange(4)\\nd[0] = 7.9\\nreturn d * x
        d = np.array([1, 2, 3, 4]) * x\\nd[1] = 2\\nreturn d
        d = np.empty((2, 2))\\nd[0] = x[:2]\\nd[1] = d[0] * 2\\nreturn d.ravel()
        d = np.concatenate([C, C])\\nd[0] = x[0]\\nreturn d
    """,
    "where= and out=": """
        np.divide(1.0, x, where=x != 0, out=np.zeros(4))
        d = np.zeros(4)\\nnp.sin(x, out=d)\\nreturn d
        d = np.zeros(4)\\nnp.dot(M, x, out=d)\\nreturn d
        d = np.zeros(4)\\nnp.maximum(x, 0.0, out=d)\\nreturn d
        d = np.zeros(4)\\nnp.copyto(d, x, where=x > 0)\\nreturn d
        d = np.zeros(4)\\nnp.put(d, [0, 2], x[:2])\\nreturn d
        d = np.eye(4)\\nnp.put(d, [3], 5.0)\\nreturn d @ x
        d = np.zeros((4, 1))\\nnp.put_along_axis(d, np.array([[2]]), 5.0, axis=0)\\nreturn d.ravel() * x
        d = np.outer(x, C)\\nnp.fill_diagonal(d, x)\\nreturn d.ravel()
        d = x.copy()\\nnp.place(d, C > 0, [1.0, 2.0])\\nreturn d
        np.clip(x > 0, 0, 1)
        np.insert((x * 3).astype(int), [1, 2], [0.7, x[0]])
        np.pad((x * 3).astype(int), 1, constant_values=0.7)
        np.insert(x > 0, 0, 5)
        np.trace(x.reshape(2, 2) > 0)
        np.sum(x.reshape(2, 2), axis=(0, 1))
        np.nansum(np.sqrt(x))
        np.nanmean(np.log(x))
        np.nan_to_num(np.sqrt(x))
        np.nan_to_num(np.sqrt(x), nan=5.0)
    """,
    "types": """
        float(C[0]) * x
        np.array([7, -7, 8, 9]) % 4 * x
        (x > 0) // 2
        (x > 0) + 1
        (x > 0) * (x < 1) + (x > 2)
        sum([v > 0 for v in x]) * 1.0
        np.round(x).astype(int) % 2
        np.sign(x).astype(int)
        7 // 2 * x
        -7 // 2 * x
        x // C
        x % C
        C % x
        x % 1
        divmod(3.0, x)[0]
        np.round(x * 100, -1)
        sum(x, 1.0)
        math.fsum([1.0, 2.0]) * x
        pow(x, 2, None)
        np.abs(x) ** x
        np.abs(x) ** (1 / 3)
        np.power(x, C)
        x.__rsub__(1.0)
    """,
    "Python around it": """
        x if x.size > 3 else -x
        list(map(np.sin, x))
        x if isinstance(x[0], (int, float)) else -x
        x if isinstance(x[0], np.generic) else -x
        x if isinstance(x > 0, np.ndarray) else 2 * x
        x if isinstance(x[0] > 0, np.bool_) else 2 * x
        x if isinstance(x[0] > 0, bool) else 2 * x
        x if x.dtype is np.dtype(float) else 2 * x
        x if hasattr(x[0], "__len__") else 2 * x
        try:\\n    y = x[9]\\nexcept IndexError:\\n    y = 1.0\\nreturn x * y
        try:\\n    y = 1.0 / x[0]\\nexcept ZeroDivisionError:\\n    y = 2.0\\nreturn x * y
        i = 0\\nwhile i < 3:\\n    x = x + 1\\n    i += 1\\nreturn x
        from numpy import zeros\\nd = zeros(4)\\nd[0] = x[0]\\nreturn d
        kept.append(float(t)) if not hasattr(t, "sx") else None\\nreturn x
        kept[:] = [2.0]\\nreturn x * kept[0]
        def g(y=x):\\n    return y * 2\\nreturn g()
        np.random.seed(1)\\nreturn x * np.random.rand()
        import copy\\nd = copy.copy(x)\\nd[0] = 1\\nreturn d
        import cmath\\nreturn abs(cmath.exp(1j * 0.3)) * x
    """,
    "texts": """
        repr(x) and x
        x * float("1.5")
    """,
    "complex numbers": """
        x.conj()
    """,
    "linear algebra, further": """
        np.linalg.norm(x.reshape(2, 2), axis=1, keepdims=True).ravel()
        np.linalg.pinv(M) @ x
        np.linalg.det(M + np.diag(x))
        np.linalg.eigh(M + M.T)[0] * x
        np.linalg.matrix_rank(M) * x
        x @ M @ x * x
        np.einsum("i,j->ij", x, C)[0]
        np.einsum(M, [0, 1], x, [1])
        np.tensordot(np.outer(x, C), M, axes=2)
        np.inner(M, x)
        np.outer(x, x, out=np.zeros((4, 4)))[0]
        (M * x).sum(axis=1)
        np.tril(M) @ x
        np.vander(x, 3, increasing=True)[0]
        np.polyval(C, x)
        np.polynomial.polynomial.polyval(x, C)
        np.polynomial.Polynomial(C)(x)
    """,
    "broadcasting and joining": """
        np.subtract.outer(x, x)[1]
        np.meshgrid(x, C)[0][1]
        np.outer(x, C)[[0, 1], [1, 2]]
        x[5:].sum() + x
        np.rot90(x.reshape(2, 2)).ravel()
        np.hstack((x[0], x[1]))
        np.r_[x, 1.0]
        np.r_[x[0], C]
        np.concatenate(x.reshape(2, 2))
        np.array((x[0], x[1]))
        np.asarray([x[0], 2])
        np.array([x[0] > 0, 2]) * x[:2]
        np.array([x.astype(int)[0], 0.5])
        np.eye(4, k=1) @ x
        np.full_like(x, x[1])
        d = np.ones_like(M)\\nd[0] = x\\nreturn d[0]
        np.linspace(x[0], x[1], 3)
        np.geomspace(1, 8, 4) * x
        np.fromfunction(lambda i: i * 2.0, (4,)) * x
    """,
    "orders, sums and differences": """
        np.sort(-x)
        np.median(C) * x
        np.median(x)
        np.argmax(C) * x
        np.argmax(x.reshape(2, 2), axis=1)
        np.max(np.abs(x))
        np.add.reduce(np.outer(x, C), axis=1)
        np.divide.reduce(x)
        np.hypot.reduce(x)
        np.cumsum(x)[-1] * x
        np.trapezoid(x, C)
        np.digitize(x[0], [0.0, 1.0]) * x
        np.searchsorted([0.0, 0.0, 1.0], x)
        np.convolve(x, C, "valid")
        np.apply_along_axis(lambda v: v * 2, 0, x)
    """,
    "choices and others": """
        np.select([x > 0], [1])
        np.piecewise(x, [x < 0, x < 1], [lambda v: v * 2, lambda v: v * 3])
        np.piecewise(x.astype(int), [x < 0, x >= 0], [-1.5, 1.5])
        np.choose([0, 1, 0, 1], [x, -x])
        np.choose((x > 0).astype(int), [x, -x])
        (x > 0).choose([x, C])
        np.where(x > 0, 1, 0) / 2
        np.where(x > 0, [1, 2, 3, 4], x)
        np.where(x[:, None] > 0, M, 0.0).sum(0)
        np.where(x > 0, 1.0 / x, np.inf)
        np.clip(x, 1.0, -1.0)
        np.clip(x.astype(int), 0, 1)
        x.clip(max=0)
        np.heaviside(x, x)
        np.arctan2(x, -1.0)
        np.interp(x, [0, 1], [0, 1])
        np.interp(x.reshape(2, 2), [0.0, 1.0], [1.0, 0.0]).ravel()
        np.interp(x, [0.0, 1.0], [1.0, 2.0], left=x[0])
        np.convolve(x, [0.5, 0.5])[1:-1]
        np.array_equal(x, x) * x
        np.can_cast(x.dtype, int) * x
        np.shape(x)[0] * x
        np.average(x)
        np.average(x.reshape(2, 2), axis=0)
        np.average(x.reshape(2, 2), weights=[[1, 2], [3, 4]])
        np.mean(x > 0) * x
        np.mean(x.astype(int))
        x.var()
        np.ptp(x.reshape(2, 2), axis=0)
        x.sum(dtype=int)
        x.cumsum()
        x.take([0, 1], axis=0)
        C.searchsorted(0.3) * x
        x.item(0) * x
        x.argmax() * x
        d = x.copy()\\nd.fill(x[0])\\nreturn d
        d = x.copy()\\nd[1] = np.nan\\nreturn np.where(np.isnan(d), 0.0, d)
        d = x.copy()\\nd[0] = True\\nreturn d
        d = x.copy()\\nd[:2] = [1, 2]\\nreturn d
        a = b = x.copy()\\na[0] = 1\\nreturn b
        x, y = x[:2], x[2:]\\nreturn x * y
        return x.astype(int)
        return x[0] > 0
        return x + np.array([1, 2, 3, 4], dtype=np.float32)
        return np.array([0.1, 0.2, 0.3, 0.4], dtype=np.float32) * 3 * x
        return x * np.array([1, 2, 3, 4], dtype=np.uint8)
        return (np.array([250, 1, 2, 3], dtype=np.uint8) + (x > 0)) * 1.0
        return np.int64(3) / 2 * x
        return np.int64(-3) // 2 * x
        return ~np.bool_(True) * x
        return (x > 0) + (x > 0).astype(int)
        return (x.astype(int) == 2) * x
        return np.sum(x.astype(int)) / 3
        return x.astype(int).sum() // 2
        return np.abs(x.astype(int))
        return np.mean((x * 3).astype(int))
        return (x * 3).astype(int) ** 2
        return (x * 3).astype(int) / (x * 3).astype(int)
        return np.square((x * 3).astype(int))
        return np.round((x * 3).astype(int), 1)
        return np.cumsum((x * 3).astype(int)) / 2
        return np.where(x > 0, (x * 3).astype(int), 0.5)
        return np.where(x > 0, (x * 3).astype(int), 0)
        return np.exp((x * 3).astype(int))
        return np.power((x * 3).astype(int), 2)
        return np.concatenate([(x * 3).astype(int), [0.5]])
        return np.array([int(2.7), x[0]])
        return np.array([1, 2, x[0].astype(int)]) / 2
        d = np.array([1, 2, x[0].astype(int)])\\nd[0] = 2.7\\nreturn d
        d = (x * 3).astype(int)\\nd += 1\\nreturn d
        d = (x * 3).astype(int)\\nd = d / 2\\nreturn d
        d = (x > 0) * 1.0\\nd[0] = 5\\nreturn d
    """,
}

_REFUSED = {
    "branches on values": """
        x if x[0] > 0 else -x
        x * max(x[0], x[1])
        x * min(x)
        x if np.any(x > 0) else -x
        x if x[0] > 0 and x[1] > 0 else -x
        x if 0.3 in x else -x
        x * len([v for v in x if v > 0])
        sorted(x)
        x if np.allclose(x, C) else -x
        x[int(t)] * x
        x[np.argmax(x)] * x
        C[x.astype(int)] * x
        np.stack([x[i] for i in range(int(x[0]) % 4)])
        {0.3: 1.0}.get(x[0], 2.0) * x
        while x[0] > 100:\\n    x = x * 0.5\\nreturn x
        try:\\n    return x if x[0] > 0 else -x\\nexcept Exception:\\n    return x
    """,
    "numbers from symbols": """
        x * math.sin(t)
        x * float(x[0])
        x * int(x[0])
        f"{x[0]}" and x
        np.vectorize(lambda v: v + 1.0)(x)
        np.array(x, dtype=np.float32) * 2.0
        x.astype(complex).real
        round(t, 1) * x
        x * complex(x[0]).real
    """,
    "the sign of a zero": """
        np.arctan2(0.0 * x, -1.0)
        np.copysign(1.0, 0.0 * x)
        np.arctan2(x - x, -1.0) + np.arctan2(x * 0.0, -1.0)
        np.tanh(1.0 / (0.0 * x))
        np.signbit(np.where(x > 5, x, -0.0)) * 1.0
    """,
    "products of Booleans": """
        np.outer(x > 0, x > 1)[0] * x
        np.dot(x > 0, x > 1) * x
        np.convolve(x > 0, x > 1)
        np.linalg.vecdot(x > 0, x > 1) * x
        np.einsum("i,i", x > 0, x > 1) * x
    """,
    "masks of numbers": """
        d = x.copy()\\nm = d > 0\\nd[m] = d[m] * C[m]\\nreturn d
        C[x > 0].sum() * x
    """,
    "options": """
        np.add(x, 1.0, where=x > 0)
        np.sum(x, dtype=np.float32)
        np.add.at(np.zeros(4), [0, 1], x[:2])
        np.add.reduceat(x, [0, 2])
    """,
    "values from outside": """
        x + np.random.rand()
        x + np.random.default_rng().normal()
        x + time.time()
        x + time.perf_counter()
        x + np.random.default_rng().normal(size=4)
        kept.append(1)\\nreturn x * len(kept)
        kept.append(x[0])\\nreturn x + kept[0]
        if not kept:\\n    kept.append(x[0])\\nreturn x * kept[0]
        kept.append(x)\\nreturn kept[-2] if len(kept) > 1 else x
    """,
    "arguments": """
        x[0] = 5.0\\nreturn x
        x += 1.0\\nreturn x
        v = x[1:]\\nv[0] = 0.0\\nreturn x
        y = x.reshape(2, 2)\\ny *= 2.0\\nreturn x
        x[x > 0] = 0.0\\nreturn x
    """,
    "shapes": """
        np.outer(x, C)
        x.reshape(2, 2)
        x[:, None]
        x[None, :]
        x + np.zeros(3)
        x[x > 0]
        x[7] * x
    """,
    "masks": """
        x[x > 0][0] * x
        len(x[x > 0]) * x
        np.max(x[x > 0]) * x
        np.sort(x[x > 0])
        x[x > 0] + x[x > 1]
        C[x > 0].sum() * x
        np.concatenate([x[x > 0], x[x <= 0]])
        d = x.copy()\\nd[x > 0] = C[:2]\\nreturn d
        d = x.copy()\\nd[x > 0][0] = 5\\nreturn d
        d = x.copy()\\nnp.place(d, x > 0, [1.0])\\nreturn d
        np.where(x > 0)[0]
        np.nonzero(x)[0]
        np.argwhere(x > 0).ravel()
    """,
    "what numpy itself refuses": """
        (x > 0) - (x > 1)
        -(x > 0)
        d = np.zeros(4, dtype=int)\\nd += x\\nreturn d
        x & 1
        x @ C[:3]
        d = x.copy()\\nd[0] = x\\nreturn d
        ~x
    """,
    "other functions": """
        np.fft.fft(x).real
        np.linalg.eigvals(np.outer(x, x)).real
        np.linalg.svd(np.outer(x, x))[1]
        np.unique(x)
        np.argsort(x) * 1.0
        np.gradient(x)
        np.percentile(x, 50)
        np.histogram(x)[0]
        np.nextafter(x, 1.0)
        np.frexp(x)[0]
        np.ldexp(x, 2)
        np.arange(x[0])
        np.zeros(int(x[0]))
        x.tobytes()
        x.sort()
        np.interp(x, x, C)
        np.empty(4)
    """,
    "Boolean masks, further": """
        np.extract(x > 0, x).sum()
        np.logical_and.reduce([x > 0, x < 2, x > -3]) * x
    """,
    "views and writes, further": """
        d = x * 1.0\\nd.resize(2, 2)\\nreturn d[0]
        d = np.zeros(4)\\nnp.add.at(d, [0, 0, 1], x[:3])\\nreturn d
        d = np.zeros(4, dtype=bool)\\nd[:] = x\\nreturn d * 1.0
        d = C.copy()\\nd[0] = x[0]\\nreturn d
    """,
    "where= and out=": """
        d = np.zeros(4, dtype=int)\\nnp.floor(x, out=d, casting="unsafe")\\nreturn d
        np.add(x, C, dtype=np.float32)
    """,
    "types": """
        x.astype(np.uint8)
        x.astype(np.float32)
        min(x[0], 1.0) * x
        math.copysign(1.0, x[0]) * x
    """,
    "Python around it": """
        (not x[0]) * x
        x if t > 5 else -x
        any(v > 0 for v in x) * x
        set(x)
        x if x[0] is x[0] else -x
        x if isinstance(t, np.floating) else -x
        x if x.strides == (8,) else 2 * x
        x if "numpy" in type(x).__module__ else 2 * x
        y = getattr(x, "foo", 3.0)\\nreturn x * y
        try:\\n    y = float(x[0])\\nexcept Exception:\\n    y = 1.0\\nreturn x * y
        try:\\n    y = x[0] if x[0] > 0 else 1.0\\nexcept BaseException:\\n    y = 2.0\\nreturn x * y
        match x[0]:\\n    case 0.3:\\n        return x\\n    case _:\\n        return -x
        y = x[0]\\nreturn x if y else -x
        kept.append(t)\\nreturn x * kept[0]
        import functools\\n@functools.lru_cache\\ndef g(v):\\n    return v * 2\\nreturn g(x[0]) * x
    """,
    "complex numbers": """
        np.angle(x + 1j * C)
        abs(complex(x[0], x[1]))
    """,
    "linear algebra, further": """
        np.linalg.norm(x, ord=0)
        np.linalg.tensorsolve(M, x)
        np.cross(x[:2], C[:2])
        np.poly(x)
    """,
    "broadcasting and joining": """
        x[[]]
        x[True]
        np.r_[0:3, x]
    """,
    "orders, sums and differences": """
        x[np.argsort(x)]
        np.nanargmax(x)
        np.minimum.reduce([x, C, -x])
        np.power.reduce(np.abs(x))
        np.nancumsum(x)
        np.isin(x, [0.3, 2.5]) * x
        np.vectorize(lambda v: v * 2)(x)
        [v for _, v in np.ndenumerate(x)]
    """,
    "choices and others": """
        np.spacing(x)
        np.ldexp(x, [1, 2, 3, 4])
        np.lcm(x.astype(int), 2)
        np.unwrap(x)
        np.interp(x, [0.0, 1.0], [1.0, 2.0], left=np.nan)
        d = x.copy()\\nd.partition(1)\\nreturn d
        d = x.copy()\\nd[0] = "1"\\nreturn d
        d = x.copy()\\nd[0] = [1.0]\\nreturn d
        d = x.copy()\\nd[0] = x[1:2]\\nreturn d
        return x, x
        return x.view(np.int64)
        return np.sum(x > 0, dtype=np.int8)
        return (x * 1e300).astype(int)
        return x.astype(int) * x.astype(int) * 10**10 * 10**9
        return np.prod((x * 3).astype(int))
        return np.left_shift((x * 3).astype(int), 1)
        return (x * 3).astype(int) & 3
    """,
}


def _rows(table: dict[str, str], expected: Expected) -> list[Idiom]:
    return [
        Idiom(kind, line.strip().replace("\\n", "\n"), expected)
        for kind, lines in table.items()
        for line in lines.splitlines()
        if line.strip()
    ]


IDIOMS = [*_rows(_EQUAL, "equal"), *_rows(_REFUSED, "refused")]
