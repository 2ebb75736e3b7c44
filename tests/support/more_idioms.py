r"""Idioms of numpy beyond the table, which a slow test runs; a line each, with `\n` for the end of a line."""

MORE_IDIOMS = r"""
x[(x > 0) & (x < 1)].sum()
x[np.abs(x) > 0.5].mean() * x
(x[x > 0] ** 2).sum()
np.sum(np.where(x > 0, x, 0.0)[x < 2])
d = np.zeros((4,))\nd[x > 0] += x[x > 0]\nreturn d
m = x > 0\nreturn x * m - x * ~m
m = np.zeros(4, dtype=bool)\nm[1] = x[0] > 0\nreturn np.where(m, x, -x)
m = x > 0\nm |= x < -1\nreturn m * x
m = x > 0\nm &= x < 1\nreturn np.sum(m) * x
m = np.array([v > 0 for v in x])\nreturn x * m
d = x.reshape(2, 2).copy()\nd[:, x[:2] > 0] = 0\nreturn d.ravel()
d = x.copy()\nd[1:][x[1:] > 0] = 9.0\nreturn d
d = x.copy()\nnp.place(d, x > 0, [0.0])\nreturn d
np.compress([True, False, True, False], x)
x[np.isfinite(x)].sum()
np.ma.masked_where(x > 0, x).sum()
x[x > 0].max(initial=0.0)
x[x.argmax()] * x
x[None][0]
x[x > np.mean(x)].sum()
np.flatnonzero(x > 0).size * x
np.sum(x > 0) / 4
np.any(x > 0) * x
np.all(x > 0, axis=0) * x
not_x = np.logical_not(x > 0)\nreturn not_x + 0.5
(x > 0).cumsum()
np.diff(x > 0)
np.max(x > 0)
np.argmax(x > 0)
(x > 0).dot(x)
(x > 0).nonzero()[0].sum() * x
np.bitwise_and(x > 0, x < 1) * x
np.bitwise_count(x > 0) * x
np.logical_or.reduce(np.stack([x > 0, x < -1])) * x
np.logical_and(x, C) * 1.0
np.logical_not(x) * 1.0
np.count_nonzero(x > 0) / x.size
d = x * 1.0\nv = d.T\nv[0] = 3\nreturn d
d = np.outer(x, x)\nd[np.diag_indices(4)] = 0\nreturn d.sum(axis=0)
d = np.outer(x, x)\nnp.fill_diagonal(d, 1.0)\nreturn d[0]
d = np.outer(x, x)\nv = d.diagonal()\nreturn v + d[0]
d = np.outer(x, x)\nv = d[::2, ::2]\nv += 1\nreturn d.ravel()[:6]
d = x * 1.0\nv = d.view()\nv[1] = 4\nreturn d
d = x * 1.0\nv = np.ravel(d)\nv[1] = 4\nreturn d
d = x * 1.0\nv = d.flatten()\nv[1] = 4\nreturn d
d = np.outer(x, x)\nd.flat = 2.0\nreturn d[0]
d = x * 1.0\nv = np.asarray(d)\nv[0] = 2\nreturn d
d = x * 1.0\nv = np.array(d)\nv[0] = 2\nreturn d
d = x * 1.0\nv = np.array(d, copy=False)\nv[0] = 2\nreturn d
x.reshape(2, 2, order="F").ravel()
x.reshape(2, 2).flatten("F")
x.reshape((2, 2)).T.ravel(order="A")
x.reshape(2, 2).ravel("K")
x.reshape(2, 2).T.ravel("K")
d = x * 1.0\nd.shape = (2, 2)\nreturn d[1]
d = np.zeros((2, 3))\nd[..., 1] = x[:2]\nreturn d.sum(0)
d = np.zeros((2, 2))\nd[:, 0], d[:, 1] = x[:2], x[2:]\nreturn d @ x[:2]
d = x.copy()\nfor v in d:\n    v += 1\nreturn d
d = x.reshape(2, 2).copy()\nfor row in d:\n    row[0] = 0\nreturn d.ravel()
d = list(x)\nd[0] = 5.0\nreturn d
d = x.tolist()\nd.reverse()\nreturn d
d = [0.0] * 4\nfor i in range(4):\n    d[i] = x[3 - i]\nreturn np.array(d)
y = x\ny = y + 1\nreturn x + y
d = x.copy()\nd[::2] = d[1::2]\nreturn d
d = x.copy()\nd[1:] = d[:-1]\nreturn d
d = x.copy()\nd[1:] += d[:-1]\nreturn d
d = x.copy()\nd[[0, 0]] = [1.0, 2.0]\nreturn d
d = x.copy()\nd[-1], d[0] = d[0], d[-1]\nreturn d
d = x.copy()\nd[:2] += d[2:]\nd[2:] -= d[:2]\nreturn d
d = x.copy()\nd[...] = d[::-1]\nreturn d
d = x.copy()\nd *= d\nreturn d
d = x.copy()\nd //= 0.3\nreturn d
d = x.copy()\nd %= 0.3\nreturn d
d = np.arange(4)\nd[0] = x[0]\nreturn d * 1.0
d = np.arange(4.0)\nd[0] = x[0]\nreturn d
d = np.zeros(4, int)\nd[:] = x\nreturn d
d = np.array([1, 2, 3, 4])\nd[1] = x[1]\nreturn d
d = np.zeros_like([1, 2, 3, 4])\nd[0] = x[0] * 3\nreturn d
d = np.zeros(4, dtype=np.float32)\nd[:] = x\nreturn d
d = np.empty(4)\nd[:3] = x[:3]\nd[3] = d[0]\nreturn d
d = np.array([x, x])\nd[0] += 1\nreturn d.sum(axis=0)
d = np.array([[x[0], 1], [2, x[1]]])\nd[0, 1] = x[2]\nreturn d.ravel()
d = np.tile(0.0, 4)\nd[0] = x[0]\nreturn d
d = np.repeat(1.0, 4)\nd[0] = x[0]\nreturn d
d = C + 0.0\nd[0] = x[0]\nreturn d
d = np.copy(C)\nd[0] = x[0]\nreturn d
d = M.copy()\nd[0, 0] = x[0]\nreturn d @ x
d = np.stack([C, C])\nd[0, 0] = x[0]\nreturn d[0]
d = np.zeros(4).tolist()\nd[0] = x[0]\nreturn d
d = np.diag([1.0, 2.0, 3.0, 4.0])\nd[0, 1] = x[0]\nreturn d @ x
d = np.random.default_rng(3).normal(size=4)\nreturn d * x
d = np.random.RandomState(1).rand(4)\nreturn d + x
np.sqrt(x, where=x > 0, out=np.zeros(4))
np.multiply(x, 2.0, out=None)
d = np.zeros(4)\nnp.multiply(x, 2.0, d)\nreturn d
d = np.zeros(4)\nnp.sin(x, d)\nreturn d + 1
d = np.zeros(4)\nnp.clip(x, -1.0, 1.0, out=d)\nreturn d
d = np.zeros(4)\nx.clip(-1, 1, d)\nreturn d
d = np.zeros(4)\nnp.cumsum(x, out=d)\nreturn d
d = np.zeros(4)\nnp.matmul(M, x, out=d)\nreturn d
d = np.zeros(())\nnp.sum(x, out=d)\nreturn d
d = np.zeros(4)\nnp.copyto(d, x)\nreturn d
np.add(x, C, dtype=float)
np.sum(x, axis=0, keepdims=True)
np.sum(x.reshape(2, 2), axis=-1)
np.nanmax(np.sqrt(x)) * x
np.nan_to_num(np.log(x * (x > 0)), neginf=-1.0)
x.astype(int) // 2
x.astype(np.int32)
x.astype(np.int32) * 2
x.astype(np.int8) * 1.0
x.astype(bool) * 1.0
x.astype("int") % 3
x.astype("float")
x.astype("f8")
x.astype(np.float64)
int(3.7) * x
np.int64(x[0] * 0 + 3) * x
np.float64(x[0]) * 2.0
np.array([1, 2, 3, 4]) / 2 * x
np.array([1, 2, 3, 4]) // 2 * x
np.arange(4) / 3 * x
np.arange(4) // 3 + x
(x > 0) / 2
(x > 0) % 2
(x > 0) ** 2
(x > 0) - 1
1 - (x > 0)
True - (x[0] > 0) * x
-(x > 0).astype(int) * x
(x > 0) | (x < -1) * x
np.add((x > 0), (x < 2)) * 1
np.subtract(1, x > 0) * x
sum(x > 0) * x
np.sum([v > 0 for v in x])
np.trunc(x).astype(int) / 2
np.floor(x).astype(int) & 1
np.rint(x) // 2
np.floor_divide(x, 0.25)
np.floor_divide(7, 2) * x
-x // C
x % -C
x[0] % 1.0 * x
(x * 10) % 3
divmod(x, 0.7)[1]
math.floor(x[0])
round(x[0], 2) * x
round(float(C[0])) * x
np.round(x, -1)
np.round(x, decimals=3)
x.round(2)
np.around(x * 2.5)
abs(x[0] - x[1]) * x
max(0.0, x[0]) * x
max(x[0], x[0]) * x
min([1.0, 2.0], default=3.0) * x
sorted([3.0, 1.0, 2.0])[0] * x
sum(v * w for v, w in zip(x, C))
sum(x[i] * i for i in range(4))
math.pi * x
math.sqrt(2.0) * x
math.fsum(x)
math.prod(x)
math.hypot(x[0], x[1])
math.isnan(x[0]) * x
math.atan2(x[0], 1.0)
math.trunc(x[0])
math.isclose(x[0], 0.3) * x
x[0].is_integer() * x
pow(2, x)
x ** 2.0
x ** -2
x ** x
x ** 4
x ** 10
(-x) ** 3
x ** (1 / 3)
2 ** x
(-2.0) ** x
np.power(x, [1, 2, 3, 4])
np.power(2, [1, 2, 3, 4]) * x
np.power(np.abs(x), -0.5)
np.exp2(x)
np.float_power(x, 2)
x.__add__(1.0)
x if x is not None else 0 * x
x if True and x is not None else 0 * x
(x[0] > 0 and x[1]) * x
(x[0] > 0 or x[1]) * x
(not (x[0] > 0)) * x
x if 0 < x[0] < 1 else -x
(0 < x[0] < 1) * x
x if t else -x
x if t == 0 else -x
x * (t >= 1)
x if x.any() else -x
x if len(x) else -x
x if bool(x[0]) else -x
x[0] and x
1.0 if x[0] else 2.0
[v for v in x if v > 0] and x
all(v > 0 for v in x) * x
any([False, True]) * x
next(v for v in x if v > 0) * x
list(filter(None, x))
np.array(list(map(lambda v: v * 2, x)))
[v * 2 for v in x][::-1]
{i: v for i, v in enumerate(x)}[2] * x
dict(a=x[0], b=x[1])["b"] * x
x[0] in (1.0, 2.0)
x[0] in [x[0]] and x
x[0] == x[0] and x
x if x[0] == 0.3 else -x
x if type(x[0]) is float else -x
x if type(x[0]) == np.float64 else -x
x if isinstance(x[0], np.floating) else -x
x if isinstance(t, float) else -x
x if isinstance(x, list) else 2 * x
x if np.issubdtype(x.dtype, np.floating) else 2 * x
x if x.dtype.name == "float64" else 2 * x
x if str(x.dtype) == "float64" else 2 * x
x if (x > 0).dtype == bool else 2 * x
x if np.isrealobj(x) else 2 * x
x if np.isscalar(x[0]) else 2 * x
x if callable(x) else 2 * x
x if hasattr(x, "is_constant") else 2 * x
x if hasattr(x, "base") and x.base is None else 2 * x
x if x.flags.writeable else 2 * x
x if x.flags["C_CONTIGUOUS"] else 2 * x
x * x.itemsize
x * x.nbytes
x if type(x).__name__ == "ndarray" else 2 * x
x if type(x) == np.ndarray else 2 * x
x if repr(x).startswith("array") else 2 * x
try:\n    y = math.sin(x[0])\nexcept TypeError:\n    y = 0.0\nreturn x * y
try:\n    y = x.foo\nexcept AttributeError:\n    y = 1.0\nreturn x * y
y = getattr(x, "size", 3.0)\nreturn x * y
try:\n    y = 1.0 / 0.0\nexcept ZeroDivisionError:\n    y = 2.0\nreturn x * y
assert x[0] > -100\nreturn x
assert len(x) == 4\nreturn x
while t < 0:\n    t = t + 1\nreturn x
for i in range(10):\n    if i > 3:\n        break\n    x = x * 1.1\nreturn x
for i in range(int(t)):\n    x = x + 1\nreturn x
for v in x:\n    if v > 0:\n        return x\nreturn -x
match len(x):\n    case 4:\n        return x\n    case _:\n        return -x
with np.errstate(all="ignore"):\n    return np.log(np.abs(x))
with np.errstate(all="raise"):\n    return x * 2
import numpy\nreturn numpy.sin(x)
from numpy import sin\nreturn sin(x)
from math import sin\nreturn sin(x[0])
global G\nG = 1.0\nreturn x * G
kept.append(t)\nreturn x * kept[-1]
if len(kept) < 3:\n    kept.append(0)\nreturn x * len(kept)
def g(y, c=[1.0]):\n    c[0] += 1\n    return y * c[0]\nreturn g(x)
def g(y, c=C):\n    return y * c\nreturn g(x)
def g():\n    return x * t\nreturn g()
f = lambda y, n=2: y ** n\nreturn f(x)
import functools\nreturn functools.reduce(lambda a, b: a + b, x)
import functools\nf = functools.partial(np.multiply, 2.0)\nreturn f(x)
import itertools\nreturn list(itertools.accumulate(x))
import operator\nreturn operator.mul(x, 2.0)
import random\nreturn x * random.random()
import random\nrandom.seed(1)\nreturn x * random.random()
import datetime\nreturn x * datetime.datetime.now().microsecond
x * (time.time() > 0)
x * time.monotonic()
x * time.process_time_ns()
import copy\nd = copy.deepcopy(x)\nd[0] = 1\nreturn d
import copy\nd = copy.copy(x[0])\nreturn d * x
import statistics\nreturn statistics.mean(x)
import statistics\nreturn statistics.median(x)
str(x[0]) and x
float(str(x[0])) * x
"%g" % x[0] and x
"{}".format(x[0]) and x
np.format_float_positional(x[0]) and x
x * len("abc")
x * len(str(x))
float(repr(t)) * x
(x + 0j).real
(x * 1j).imag
np.abs(x + 1j)
np.exp(1j * x).real
np.conj(x)
np.real(x)
np.imag(x)
x.imag
x.real
np.iscomplex(x) * x
np.sqrt(x.astype(complex)).real
np.roots([1.0, x[0], x[1]]).real
np.emath.sqrt(x).real
np.linalg.norm(x - C)
np.linalg.norm(x, ord=2)
np.linalg.norm(x, ord=3)
np.linalg.norm(x, ord=-np.inf)
np.linalg.norm(np.outer(x, C))
np.linalg.norm(np.outer(x, C), 2)
np.linalg.norm(np.outer(x, C), 1)
np.linalg.norm(np.outer(x, C), axis=0)
np.linalg.vector_norm(x)
np.linalg.matrix_norm(np.outer(x, C))
np.linalg.solve(np.diag(x) + 5 * np.eye(4), C)
np.linalg.inv(M + np.diag(x ** 2))[0]
np.linalg.pinv(np.outer(x, C)) @ x
np.linalg.lstsq(M, x)[0]
np.linalg.lstsq(M, x, rcond=None)[0]
np.linalg.det(M) * x
np.linalg.det(x.reshape(2, 2))
np.linalg.slogdet(M)[1] * x
np.linalg.slogdet(np.diag(x))[1]
np.linalg.eigvalsh(np.diag(x))
np.linalg.cholesky(np.diag(x ** 2 + 1)).ravel()
np.linalg.cholesky(M @ M.T) @ x
np.linalg.qr(np.outer(x, x))[1].ravel()
np.linalg.cond(M) * x
np.linalg.matrix_power(M, 2) @ x
np.linalg.matrix_power(np.outer(x, C), 3)[0]
np.linalg.matrix_power(np.diag(x + 5), -1)[0]
np.linalg.multi_dot([M, np.outer(x, C), x])
M @ M @ x
M.T @ x
(M @ x) @ (M @ x)
x @ x
x[:, None] @ x[None, :] @ C
np.matmul(x[None, :], M).ravel()
np.matmul(np.stack([M, M]), x)[1]
np.einsum("ij,jk,k->i", M, M, x)
np.einsum("ii->i", np.outer(x, C))
np.einsum("ij->ji", np.outer(x, C))[0]
np.einsum("ii", np.outer(x, C))
np.einsum("...i,i", M, x)
np.einsum("i,i", x, x, optimize=True)
np.einsum("ij,j->i", M, x, optimize="greedy")
np.tensordot(x, M, 1)
np.tensordot(np.outer(x, C), M, axes=([1], [0]))[0]
np.dot(x, x)
np.dot(2.0, x)
np.dot(x, 2.0)
np.dot(x.reshape(2, 2), x.reshape(2, 2)).ravel()
np.inner(x, x)
np.kron(np.eye(2), x.reshape(2, 2))[0]
np.cross(x[:3], [1.0, 0.0, 0.0])
np.trace(M * x)
np.trace(np.outer(x, C), offset=1)
np.vdot(M, np.outer(x, x))
M * x
(M * x[:, None]).sum(0)
np.diag(np.diag(np.outer(x, C)))[1]
np.diag(x, k=1)[0]
np.triu(np.outer(x, C), 1).sum(axis=0)
np.linalg.solve(np.triu(M), x)
np.matrix(M) @ x
np.asmatrix(x)
np.vander(x, 3)[0]
np.polyfit([0.0, 1.0, 2.0], x[:3], 1)
np.poly1d(C)(x)
np.polyder(x)
np.polyint(x)
np.polymul(x, C)
np.polyadd(x, C)
x[:, None] + C[None, :] > 0
(x[:, None] + C).sum(axis=1)
(x[:, np.newaxis] - x).ravel()
np.add.outer(x, C).sum(0)
np.minimum.outer(x, C)[0]
np.hypot.outer(x, C)[0]
np.broadcast_to(x, (2, 4))[1]
np.broadcast_arrays(x, M)[0][2]
np.meshgrid(x, C, indexing="ij")[0][1]
np.ix_([0, 1])[0].ravel() * x[:2]
M[np.ix_([0, 1], [1, 2])] @ x[:2]
np.outer(x, C)[np.ix_([0, 2], [1, 3])].ravel()
np.outer(x, C)[1:3, ::2].ravel()
np.outer(x, C)[..., -1]
np.outer(x, C)[:, [3, 0]][0]
x[np.array([[0, 1], [2, 3]])][1]
x[:0].sum() + x
np.sum([]) + x
x[(0,)] * x
x[np.int64(1)] * x
x[slice(1, 3)]
x[-3:-1]
x[::-2]
x[None, ..., None].ravel()
np.atleast_2d(x).T.ravel()
np.squeeze(x[None, :])
np.moveaxis(np.outer(x, C), 0, 1)[0]
np.swapaxes(np.outer(x, C), 0, 1)[0]
np.flipud(x)
np.fliplr(x.reshape(2, 2)).ravel()
np.roll(np.outer(x, C), 1, axis=1)[0]
np.roll(x, -2)
np.vstack((x, C)).sum(0)
np.dstack((x, C)).ravel()
np.c_[x, C][0]
np.s_[1:3] and x
np.concatenate([x[:1], x[1:] * 2, [t]])
np.concatenate([np.outer(x, C), M], axis=1)[0]
np.stack((x, C), axis=-1).ravel()
np.stack([x, x + 1]).mean(axis=0)
np.array([x, C]).T.ravel()
np.array([[x]])[0, 0]
np.array([*x, 1.0])
np.array([x[:2], x[2:]]).ravel()
np.array([np.sin(v) for v in x])
np.array(x, ndmin=2)[0]
np.fromiter((v * 2 for v in x), float)
np.array([x[0]] * 3)
np.array([x > 0, x < 0]).any(axis=0) * x
np.array([x[0], True])
np.zeros((4,)) + x
np.zeros(4) + np.zeros(4) + x
np.ones((2, 2)) @ x[:2]
np.eye(3, 4) @ x
np.identity(4) @ x
np.full((4,), x[0]) + x
np.full(4, 2) * x
np.full_like(C, x[1])
np.zeros_like(C) + x
np.empty_like(x) * 0 + x
d = np.zeros_like(C)\nd[0] = x[0]\nreturn d
np.linspace(0, 1, 5)[2] * x
np.linspace(0.0, t, 4) * x
np.logspace(0, 1, 4) * x
np.arange(x.size) * x
np.arange(0.0, 1.0, 0.25) * x
np.indices((2, 2))[0].ravel() * x
np.tri(4) @ x
np.fromfunction(lambda i: i * x[0], (4,))
np.sort(x)[::-1]
np.sort(x.reshape(2, 2), axis=0).ravel()
np.sort(x.reshape(2, 2), axis=1).ravel()
np.sort(x.reshape(2, 2), axis=None)
np.sort(x, kind="stable")
np.argsort(x)
np.argsort(C)[0] * x
x[np.argsort(C)]
np.partition(x, 1)[0]
np.lexsort((x,))
sorted(x, key=lambda v: -v)
np.quantile(x, 0.5)
np.percentile(C, 30) * x
np.argmax(x) * 1.0
np.argmin(np.abs(x))
np.max(x, axis=0)
np.max(x.reshape(2, 2), axis=1)
np.maximum.accumulate(x)
np.minimum.accumulate(x[::-1])
np.maximum.reduce(x.reshape(2, 2), axis=1)
np.multiply.reduce(x)
np.multiply.accumulate(x)
np.subtract.reduce(x)
np.subtract.accumulate(x)
np.logical_xor.reduce(x > 0) * x
np.arctan2.reduce(x)
np.cumsum(x.reshape(2, 2), axis=0).ravel()
np.cumsum(np.outer(x, C))[3]
np.cumprod(x + 1.0)
np.cumulative_sum(x)
np.diff(x, n=2)
np.diff(x, prepend=0.0)
np.diff(x.reshape(2, 2), axis=0).ravel()
np.ediff1d(x)
np.trapezoid(x, [0.0, 1.0, 3.0, 4.0])
np.trapezoid(x, x=np.arange(4.0))
np.trapezoid(np.outer(x, C), axis=0)
np.unique(C)[0] * x
np.intersect1d(x, C)
np.histogram(x, bins=3)[0]
np.bincount([0, 1, 1, 2]) * x[:3]
np.bincount([0, 1, 1, 2], weights=x)
np.searchsorted(np.sort(C), x[0]) * x
np.searchsorted(x, 0.5)
np.convolve(x, C, mode="same")
np.correlate(x, C)
np.correlate(x, C[:2], "full")
np.apply_over_axes(np.sum, x.reshape(2, 2), [0]).ravel()
np.vectorize(lambda v: 1.0 if v > 0 else 0.0)(x)
np.frompyfunc(lambda v: v * 2, 1, 1)(x)
np.nditer(x)
[v for v in np.nditer(x)]
[x[i] for i in np.ndindex(4)]
np.select([x > 1, x > 0, x > -1], [x, x * 2, 3.0])
np.select([x > 1, x > 0], [C, 2.0], default=x)
np.select([x[0] > 1, x[0] > 0], [x, 2 * x], default=-x)
np.select([True, x > 0], [x, -x])
np.select([(x > 0)[0]], [x])
np.piecewise(x, [x < 0], [lambda v: -v])
np.piecewise(x, [x < 0], [-1.0, 1.0])
np.piecewise(x, [x < 0, x > 1], [-1, 1, lambda v: v])
np.piecewise(x, x < 0, [lambda v: -v, lambda v: v])
np.piecewise(x[0], [x[0] < 0, x[0] >= 0], [-1, 1])
np.piecewise(x, [x < 0, x >= 0], [lambda v, a: a * v, lambda v, a: v], 3.0)
np.choose(x > 0, [x, -x])
np.where(x > 0, 1, 0)
np.where(x > 0, 1, 0) // 2
np.where(x > 0, True, False) * x
np.where(x > 0, True, False) + np.where(x > 1, True, False)
np.where(x > 0, x > 1, x < -1) * x
np.where(x, 1.0, 2.0)
np.where(x[0] > 0, x, C)
np.where(x[0] > 0, x[1], 3)
np.where(x[0] > 0, 3, 4) * x
np.where([True, False, True, False], x, C)
np.where(True, x, C)
np.where(x > 0, np.log(np.abs(x)), 0.0)
np.where(x != 0, 1.0 / x, 0.0)
np.where(np.isinf(1.0 / x), 0.0, x)
np.where(np.isnan(x / x), 1.0, x)
np.clip(x, C, 3.0)
np.clip(x, -1, None)
np.clip(x, a_min=-1, a_max=1)
np.clip(x, x[0], x[1])
np.clip(np.sqrt(x), 0.0, 1.0)
np.minimum(np.maximum(x, -1), 1)
np.fmin(np.sqrt(x), 1.0)
np.maximum(np.sqrt(x), 1.0)
np.heaviside(x, 1.0)
np.sign(x) * np.sqrt(np.abs(x))
np.signbit(-x) * 1
np.copysign(x, -1.0)
np.copysign(1.0, x) * C
np.nextafter(x, 0.0)
np.modf(x)[0]
np.modf(x)[1]
np.frexp(x)[1]
np.gcd(4, 6) * x
np.i0(x)
np.sinc(x / 2)
np.angle(x)
np.hypot(x[0], x[1])
np.logaddexp(x, x[::-1])
np.logaddexp2(x, C)
np.arctan2(0.0, x)
np.arctan2(x, x)
np.tan(x) / np.tan(x)
np.deg2rad(x * 180)
np.interp(x, [0, 1, 3], [0, 1, 9])
np.interp(t, [0.0, 1.0], [5.0, 6.0]) * x
np.interp(x, C[[1, 3, 0, 2]], C)
np.interp(x[0], [0.0, 1.0, 2.0], x[:3])
np.interp(x, [0.0], [5.0])
np.interp(x, [1.0, 0.0], [1.0, 2.0])
np.interp(x, [0.0, 1.0, 1.0, 2.0], [0.0, 1.0, 5.0, 6.0])
np.interp(x, [0.0, 1.0, 2.0], [1.0, 2.0, 1.0], period=2.0)
np.interp(x, np.linspace(-3, 3, 50), np.sin(np.linspace(-3, 3, 50)))
np.interp(np.sqrt(x), [0.0, 1.0], [1.0, 2.0])
np.interp(x, [0.0, np.inf], [1.0, 2.0])
np.isclose(x, C, atol=0.5)
np.isclose(x, C, rtol=0.5) * x
np.allclose(C, C) * x
np.array_equal(x, C) * x
np.array_equiv(x, C) * x
np.shares_memory(x, C) * x
np.may_share_memory(x, x) * x
np.result_type(x, 1).itemsize * x
np.min_scalar_type(3).itemsize * x
np.finfo(x.dtype).eps + x
np.promote_types(x.dtype, int) == float and x
np.size(x, 0) * x
np.ndim(x[0]) + x
np.broadcast_shapes(x.shape, (4,))[0] * x
np.average(x, weights=C)
np.average(x.reshape(2, 2), axis=0, weights=[1, 3])
np.average(x, returned=True)[1] * x
np.mean(x.reshape(2, 2), 0)
np.var(x, ddof=1)
np.var(x.reshape(2, 2), axis=1)
x.std(ddof=1)
np.cov(x, C)[0]
np.corrcoef(x, C)[0, 1] * x
np.prod(x, axis=0)
np.prod(x.reshape(2, 2), 1)
np.linalg.norm(np.stack([x, C]), axis=0)
x.sum(0)
x.sum(axis=None)
x.sum(dtype=float)
x.reshape(2, 2).sum(1)
x.max(axis=0)
x.mean(0)
x.prod()
x.dot(M)
x.trace if False else x
x.reshape(2, 2).trace() * x
x.repeat(2)
x.searchsorted(0.0)
x.squeeze()
x.swapaxes(0, 0)
x.item() * x
x[0].item() * x
x.T @ x
x.mT
x.ptp()
x.setflags(write=True)
x.sort()\nreturn x
d = x.copy()\nd.sort()\nreturn d
d = x.copy()\nd.put([0], 5.0)\nreturn d
d = x.copy()\nnp.put(d, [0, 1], [5.0, 6.0])\nreturn d
d = x.copy()\nd.itemset(0, 5.0)\nreturn d
d = x.copy()\nnp.random.shuffle(d)\nreturn d
d = x.copy()\ndel d\nreturn x
d = x.copy()\nd[0] = None\nreturn d
d = x.copy()\nd[0] = np.array(3.0)\nreturn d
d = x.copy()\nd[:] = x[0]\nreturn d
d = x.copy()\nd[0] = 1j\nreturn d
s = 0\nfor v in x:\n    s += v\nreturn s * x
s = 0.0\nfor i, v in enumerate(x):\n    s = s + v * i if i % 2 else s - v\nreturn s
s = x[0]\nt2 = s\ns *= 2\nreturn t2 * x
a = x.copy()\nb = [a, a]\nb[0][1] = 2\nreturn b[1]
y = [x[0], x[1]]\ny.append(x[2])\nreturn y
y = [x, C]\nreturn np.concatenate(y)
y = (x, C)\nreturn y[0] + y[1]
*a, b = x\nreturn np.array(a) * b
return None
return 3.0
return [1.0, 2.0]
return [x[0], [x[1]]]
return {"a": x}
return "x"
return x > 0
return np.float32(1.5)
return (v for v in x)
return np.matrix(x)
return [float(c) for c in C]
return 1j * x
return np.nan * x
return np.inf * x
return np.array([np.inf, 1.0])
return x + np.array([0.1, 0.2, 0.3, 0.4], dtype=np.float32)
return x * np.float32(0.1)
return x + np.int8(127) + np.int8(1)
return x * np.uint8(200)
return (np.array([200], dtype=np.uint8) + np.array([100], dtype=np.uint8))[0] * x
return (np.arange(4, dtype=np.uint8) - np.uint8(1)) * x
return (x > 0).astype(np.uint8) * 255
return (x > 0).astype(np.uint8) - 1
return (x > 0).astype(np.int8) * 100 * 2
return (x > 0).view(np.int8) * 2
return np.float16(0.1) * x
return np.sum(x > 0, dtype=float)
return (x * 1e10).astype(int) % 7
return np.array(3) // np.array(2) * x
return np.array([3]) / np.array([2]) * x
return np.array([1, 2, 3, 4]) ** 2 * x
return np.array([1, 2, 3, 4]) ** -1.0 * x
return x * np.bool_(True)
return x + np.bool_(True)
return np.bool_(True) + (x > 0)
return True + (x > 0)
return (x > 0).astype(int) + (x > 1).astype(int) + 0.5
return x.astype(int) @ np.array([1, 2, 3, 4])
return np.minimum(x.astype(int), 1)
return np.max(x.astype(int)) + 0.5
return np.sqrt((x * 3).astype(int) ** 2)
return np.sign((x * 3).astype(int))
return -(x * 3).astype(int)
return np.diff((x * 3).astype(int))
return np.clip((x * 3).astype(int), -2, 2)
return np.power((x * 3).astype(int), 2.0)
return np.bitwise_and((x * 3).astype(int), 1)
return (x * 3).astype(int) << 1
return np.stack([(x * 3).astype(int), x]).sum(0)
return np.array([1, 2, x[0].astype(int)]) // 2
d = (x * 3).astype(int)\nd[0] = 1.7\nreturn d
d = (x * 3).astype(int)\nd *= 2\nreturn d / 4
d = x > 0\nd[0] = 5\nreturn d + 0
d = (x > 0) * 1\nd[0] = 5\nreturn d
d = np.where(x > 0, 1, 0)\nd[0] = 0.5\nreturn d
d = np.full(4, 1)\nd[0] = x[0]\nreturn d
d = np.full(4, 1)\nd = d * x\nreturn d
d = np.ones(4, dtype=int)\nd[1] = x[1] * 10\nreturn d
""".strip().splitlines()
