"""Random programs of numpy, as models may have them: expressions of vectors, numbers and conditions, writes, views."""

from __future__ import annotations

import re

from hypothesis import strategies as st

from tests.support.idioms import Idiom

#: What stands for an expression: V vector (4,), W matrix (2, 2), S number, B Booleans (4,), I whole numbers (4,).
_EXPRESSIONS = {
    "V": """
        x
        C
        d
        V + V
        V - V
        V * V
        V * S
        S - V
        V / (1.0 + np.abs(V))
        V / S
        -V
        V**2
        abs(V)
        V % 0.7
        V // 0.3
        np.fmod(V, 1.5)
        np.sin(V)
        np.tanh(V)
        np.exp(-np.abs(V))
        np.sqrt(V)
        np.sqrt(np.abs(V))
        np.floor(V)
        np.rint(V)
        np.round(V, 1)
        np.sign(V)
        np.minimum(V, V)
        np.maximum(V, S)
        np.fmax(V, V)
        np.clip(V, -1.0, S)
        np.clip(V, None, V)
        np.where(B, V, V)
        np.where(B, S, V)
        np.where(B, V, 0)
        np.select([B, B], [V, V], S)
        np.copysign(V, V)
        np.heaviside(V, 0.5)
        np.arctan2(V, V)
        np.hypot(V, S)
        V[::-1]
        V[[2, 0, 3, 1]]
        np.roll(V, 1)
        np.sort(V)
        np.cumsum(V)
        np.maximum.accumulate(V)
        np.append(np.diff(V), S)
        np.concatenate([V[:2], V[2:]])
        np.array([S, S, S, S])
        np.stack([v * 2.0 for v in V])
        np.append(V[1:], [S])
        M @ V
        V @ M
        np.outer(V, V)[1]
        np.einsum("ij,j->i", M, V)
        np.interp(V, PLACES, VALUES)
        np.interp(V, [-1.0, 0.5, 2.0], [3.0, 1.0, -1.0])
        np.interp(V, PLACES, VALUES, left=S)
        W.ravel()
        W.T.ravel()
        np.ravel(W, order="F")
        B * V
        B * 1.0
        I * V
        I / 2
        I + V
        np.nan_to_num(V)
        np.multiply(V, V, out=np.zeros(4))
        np.divide(V, V, where=B, out=np.ones(4))
        (V if np.ndim(V) == 1 else S)
        helper(V)
    """,
    "W": """
        V.reshape(2, 2)
        np.outer(V, V)[:2, 1:3]
        W + W
        W * S
        W.T
        W @ W
        W[::-1]
        np.where(B.reshape(2, 2), W, W)
        np.stack([V[:2], V[2:]])
        np.diag(V[:2])
        np.sort(W, axis=0)
        np.maximum(W, W[0])
    """,
    "S": """
        t
        0.5
        2
        V[0]
        V[-1]
        W[0, 1]
        np.sum(V)
        V.max()
        np.min(V)
        np.mean(V)
        np.median(V)
        np.sum(V[B])
        (V[B]).sum()
        np.sum(V, where=B)
        np.dot(V, V)
        np.linalg.norm(V)
        np.sum(B)
        np.argmax(V)
        np.any(B) * 1.0
        np.trace(W)
        np.linalg.det(W + 5.0 * np.eye(2))
        np.where(B[0], S, S)
        S + S
        S * S
        round(S)
        np.interp(S, PLACES, VALUES)
        I[1]
    """,
    "B": """
        V > V
        V >= S
        V < 0
        V == np.round(V)
        V != V
        ~B
        B & B
        B | B
        B ^ B
        B[::-1]
        np.logical_and(B, V)
        np.isnan(np.sqrt(V))
        np.isfinite(1.0 / V)
        (V > 0) + (V > 1)
        (V > 0) == (V > S)
        I == 1
        np.signbit(V)
    """,
    "I": """
        V.astype(int)
        np.floor(V).astype(int)
        np.where(B, 1, 0)
        B.astype(int)
        B + 1
        I + I
        I * 2
        I // 3
        I % 4
        -I
        np.cumsum(B)
        np.abs(I)
        np.searchsorted([-1.0, 0.0, 0.5], V)
    """,
}
_STATEMENTS = """
    d = V
    d = V * 1.0
    d = (V).copy()
    d = np.zeros(4)
    d[0] = S
    d[1:] = V[1:]
    d[B] = S
    m = B\\nd[m] = V[m]
    m = B\\nd[m] *= V[m]
    d[B] += 1.0
    d[d > 1] = d[d > 1] ** 2
    d[1:] += d[:-1]
    d[0], d[3] = d[3], d[0]
    d[:2], d[2:] = d[2:], d[:2]
    d[[0, 2]] = V[:2]
    d += V
    d *= S
    d //= 0.5
    v = d[::2]\\nv *= S
    v = d.reshape(2, 2)\\nv[0] = S
    v = d.T\\nv[1] = S
    for i in range(3):\\n    d[i + 1] = d[i] * 0.5 + (V)[i]
    for v in d[:2]:\\n    v += 1.0
    np.add(d, V, out=d)
    np.copyto(d, V, where=B)
    e = d\\ne += 1.0
    e = d.copy()\\ne[0] = S\\nd = d + e
    s = S\\ns += 1.0\\nd = d * s
    d = np.append(d[1:], S)
"""
_HEADER = """
PLACES, VALUES = np.linspace(-3.0, 3.0, 25), np.cos(np.linspace(-3.0, 3.0, 25))
def helper(y, factor=[2.0]):
    y = y * factor[0]
    y[0] = 1.0
    return y
d = x.copy()
"""
_TABLE = {kind: [line.strip() for line in lines.splitlines() if line.strip()] for kind, lines in _EXPRESSIONS.items()}
#: What ends a branch of an expression that is deep enough.
_LEAVES = {
    "V": ["x", "C", "d"],
    "W": ["x.reshape(2, 2)"],
    "S": ["t", "x[1]", "0.5"],
    "B": ["x > 0.3"],
    "I": ["np.arange(4)"],
}


@st.composite
def programs(draw: st.DrawFn) -> Idiom:
    """A program of some statements."""

    def filled(text: str, depth: int) -> str:
        return re.sub(r"\b[VWSBI]\b", lambda m: f"({expression(m[0], depth)})", text)

    def expression(kind: str, depth: int) -> str:
        return filled(draw(st.sampled_from(_TABLE[kind] if depth > 0 else _LEAVES[kind])), depth - 1)

    statements = [line.strip() for line in _STATEMENTS.splitlines() if line.strip()]
    lines = [filled(draw(st.sampled_from(statements)), 2) for _ in range(draw(st.integers(0, 4)))]
    body = "\n".join([_HEADER.strip(), *lines, f"return {expression('V', 3)}"]).replace("\\n", "\n")
    return Idiom("program", body, "equal")
