"""A traced graph as C with loops: expressions of one shape whose operands lie at equal distances are one `for`.

Tracing unrolls what the author wrote with arrays. Here the repeats are found again: expressions are grouped by their
shape, sorted by where their operands lie, and runs with equal distances become loops, runs of such runs two loops, one
in the other. Long sums, and products and extremes, are loops over their terms around a loop over the sums of one shape.
Recurrences, each of whose values is computed from the one before, are loops in their order. Every operation is the
traced one, and sums keep the order of their terms, so the results are the same to the last bit.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from operator import sub
from typing import NamedTuple, TypeVar

from fmu_export.errors import needs
from fmu_export.native.expressions import SCALARS, Tables, applied, operand, without_parentheses
from fmu_export.trace.graph import SINES, Graph

with needs("export"):
    import casadi as ca

#: Shorter repeats are written one by one.
_SHORTEST = 4
#: A sum of fewer terms is an expression.
_FEWEST_TERMS = 8
#: Expressions of more operands are divided.
_MOST_LEAVES = 24
#: Results of no more operands are computed as often as they are wanted.
_FEW_LEAVES = 4

#: Where the shapes, each once, have a larger part of all operands, too little repeats.
_MOST_SHAPES = 0.25

#: For no more than these statements no other order of the items is tried.
_FEW_BLOCKS = 4

#: What is made of many terms in their order, like a sum, by operation: that of its first term, with which others of its
#: kind go together.
_SUMS = {
    ca.OP_ADD: ca.OP_ADD,
    ca.OP_SUB: ca.OP_ADD,
    ca.OP_MUL: ca.OP_MUL,
    ca.OP_FMIN: ca.OP_FMIN,
    ca.OP_FMAX: ca.OP_FMAX,
    ca.OP_AND: ca.OP_AND,
    ca.OP_OR: ca.OP_OR,
}

#: Those whose operands may change their places.
_COMMUTATIVE = (ca.OP_ADD, ca.OP_MUL)

#: Array of the values that other expressions use.
_STORE = "w"
_CONSTANT = "constant"

_T = TypeVar("_T")


class _Tree(NamedTuple):
    """An expression: number of its shape, and nodes at its leaves."""

    shape: int
    leaves: tuple[int, ...]


class _Piece(NamedTuple):
    """Terms of a sum that have one shape and operands at equal distances; an expression is one piece of one term."""

    operation: int
    shape: int
    n_terms: int
    #: Where the operands of the first term lie, and how far from there those of the next.
    places: tuple[int, ...]
    strides: tuple[int, ...]
    #: Values of each constant of the shape, by term.
    constants: tuple[tuple[float, ...], ...]

    @property
    def kind(self) -> tuple[object, ...]:
        """What is equal in pieces that can stand in one loop."""
        return self.operation, self.shape, self.n_terms, self.strides


class _Item(NamedTuple):
    """A value to compute: its target, an element of an array, and the pieces that it is the sum of."""

    array: str
    target: int
    #: Its node.
    position: int
    pieces: tuple[_Piece, ...]

    @property
    def kind(self) -> tuple[object, ...]:
        """What is equal in items that can stand in one loop."""
        return self.array, *(piece.kind for piece in self.pieces)

    @property
    def is_sum(self) -> bool:
        """Whether there is more than one term."""
        return len(self.pieces) > 1 or self.pieces[0].n_terms > 1

    @property
    def places(self) -> tuple[int, ...]:
        """Where all operands lie, then the target."""
        return (*(place for piece in self.pieces for place in piece.places), self.target)


class LoopWriter:
    """Writes a function with loops where expressions repeat.

    Parameters
    ----------
    graph : Graph
    arguments : sequence of str
        Names of its arguments.
    tables : Tables
        Gets the constants that loops count through.
    """

    def __init__(self, graph: Graph, arguments: Sequence[str], tables: Tables) -> None:
        self.graph, self.arguments, self.tables = graph, arguments, tables
        self.shapes: list[tuple[object, ...]] = []
        self._shape_numbers: dict[tuple[object, ...], int] = {}
        self._store = self._shape(_STORE)
        self.trees: dict[int, _Tree] = {}
        self.sums, self.partial = _sums(graph)
        self.result_counts = Counter(graph.results.values())
        self.stored = {total for total in self.sums if graph.uses[total] > 1 or not self.result_counts[total]}
        self.stored |= graph.angles
        self.slots: dict[int, int] = {}
        self.n_slots = 0
        self.lines: list[str] = []
        self._find_trees()

    # Shapes

    def _shape(self, *key: object) -> int:
        number = self._shape_numbers.setdefault(key, len(self.shapes))
        if number == len(self.shapes):
            self.shapes.append(key)
        return number

    def _reference(self, position: int) -> _Tree:
        """A node as an operand of another: its expression, or where its value is stored."""
        if position in self.stored and not self.graph.nodes[position].is_leaf:
            return _Tree(self._store, (position,))
        return self.trees[position]

    def _find_trees(self) -> None:
        for position, node in enumerate(self.graph.nodes):
            if node.operation == ca.OP_CONST:
                self.trees[position] = _Tree(self._shape(_CONSTANT), (position,))
            elif node.operation == ca.OP_INPUT:
                self.trees[position] = _Tree(self._shape(self.arguments[node.operands[0]]), (position,))
            elif node.operation in SINES:
                self.trees[position] = _Tree(self._store, (position,))
            elif position in self.sums:
                terms = [self._reference(term) for _, term in self.sums[position]]
                leaves = tuple(leaf for tree in terms for leaf in tree.leaves)
                self.trees[position] = _Tree(self._shape("sum", position), leaves)
            elif position not in self.partial:
                self.trees[position] = self._tree(position)
                while len(self.trees[position].leaves) > _MOST_LEAVES:
                    self._divide(position)
                if self.graph.uses[position] > 1 and not self._is_small_result(position, self.trees[position].leaves):
                    self.stored.add(position)

    def _tree(self, position: int) -> _Tree:
        """The expression of an operation."""
        node = self.graph.nodes[position]
        shape, leaves = [node.operation], list[int]()
        for i in node.operands:
            tree = self._reference(i)
            shape.append(tree.shape)
            leaves += tree.leaves
        return _Tree(self._shape(*shape), tuple(leaves))

    def _divide(self, position: int) -> None:
        """Store what makes an expression long: along its longest operands the next one that is made as it is.

        Of a recurrence these are values some steps before, and all pieces of it have one shape.
        """
        nodes, path = self.graph.nodes, [position]
        while len(self._reference(path[-1]).leaves) > 1:
            path.append(max(nodes[path[-1]].operands, key=lambda i: len(self._reference(i).leaves)))
        alike = (i for i in path[1:-1] if nodes[i].operation == nodes[position].operation)
        divided = next(alike, path[1])
        self.stored.add(divided)
        for i in reversed(path[: path.index(divided)]):
            self.trees[i] = self._tree(i)

    def _is_small_result(self, position: int, leaves: tuple[int, ...]) -> bool:
        """Whether nothing but results is a value that is soon computed: each is better computed where it belongs."""
        return self.graph.uses[position] == self.result_counts[position] and len(leaves) <= _FEW_LEAVES

    @property
    def repeats(self) -> bool:
        """Whether expressions have so few shapes that loops can be worth while."""
        values = [*self.stored, *(i for i in self.graph.results.values() if i not in self.stored)]
        single = [self.trees[i] for i in values if i not in self.sums]
        terms = [self._reference(term) for i in values if i in self.sums for _, term in self.sums[i]]
        each_once = {tree.shape: len(tree.leaves) for tree in [*single, *terms]}
        return sum(each_once.values()) < _MOST_SHAPES * sum(len(tree.leaves) for tree in [*single, *terms])

    # Order

    def _needs(self, position: int) -> set[int]:
        """Stored values that the expression of a node reads; for a sine its angle, with which it is written."""
        nodes = self.graph.nodes
        read = (leaf for leaf in self.trees[position].leaves if not nodes[leaf].is_leaf)
        return {nodes[leaf].operands[0] if nodes[leaf].operation in SINES else leaf for leaf in read}

    def _ordered(self) -> tuple[dict[int, int], list[list[int]]]:
        """How many stored values have to come before each, and the recurrences, each of which comes as a whole."""
        needs = {position: self._needs(position) for position in sorted(self.stored)}
        recurrences = self._recurrences(needs)
        while True:
            first = {member: members[0] for members in recurrences for member in members}
            levels = _levels(needs, first)
            possible = [members for members in recurrences if members[0] in levels]
            if len(possible) == len(recurrences):
                return levels, recurrences
            recurrences = possible  # some of the others wait for each other

    def _recurrences(self, needs: dict[int, set[int]]) -> list[list[int]]:
        """Stored values of one shape, each of which reads the one before, where that makes the longer loops."""
        others = self.graph.angles | set(self.sums)
        of_shape = Counter(self.trees[position].shape for position in needs if position not in others)
        following: dict[int, list[int]] = {}
        for position, operands in needs.items():
            if position in others:
                continue
            shape = self.trees[position].shape
            before = max((i for i in operands if self.trees[i].shape == shape and i not in others), default=-1)
            chain = following.pop(before, [])
            chain.append(position)
            following[position] = chain
        return [chain for chain in following.values() if len(chain) ** 2 > of_shape[self.trees[chain[0]].shape]]

    # Values in the order of their levels

    def write(self) -> list[str]:
        """The statements that compute `y`."""
        levels, recurrences = self._ordered()
        chains: dict[int, list[list[int]]] = defaultdict(list)
        for members in recurrences:
            chains[levels[members[0]]].append(members)
        in_chains = {member for members in recurrences for member in members}
        jobs: dict[int, list[tuple[str, int, int]]] = defaultdict(list)
        for position in sorted(self.stored - in_chains):
            jobs[levels[position]].append((_STORE, 0, position))
        for target, position in sorted(self.graph.results.items()):
            read = {position} if position in self.stored else self._needs(position)
            jobs[max((levels[i] + 1 for i in read), default=0)].append(("y", target, position))
        zero = _Piece(ca.OP_ADD, self._shape(_CONSTANT), 1, (), (), ((0.0,),))
        zeros = [i for i in range(self.graph.n_results) if i not in self.graph.results]
        for rows in _blocks([_Item("y", i, -1, (zero,)) for i in zeros]):
            self._write_loop(rows)
        for level in sorted(jobs | chains):
            angles = [job for job in jobs[level] if job[0] == _STORE and job[2] in self.graph.angles]
            if angles:
                self._write_jobs(angles)
                self._write_sines([position for _, _, position in angles])
            self._write_jobs([job for job in jobs[level] if job not in set(angles)])
            for members in chains[level]:
                self._write_recurrence(members)
        return ([f"double {_STORE}[{self.n_slots}];"] if self.n_slots else []) + self.lines

    def _write_recurrence(self, members: list[int]) -> None:
        """Stored values in their order, each of which reads the one before."""
        for member in members:
            self.slots[member] = self.n_slots
            self.n_slots += 1
        items = [_Item(_STORE, self.slots[member], member, self._pieces(_STORE, member)) for member in members]
        for run in _runs(items, lambda item: item.kind, lambda item: item.places):
            self._write_loop([run])

    def _write_jobs(self, jobs: list[tuple[str, int, int]]) -> None:
        """Values that do not depend on each other: array, target and node of each."""
        groups: dict[tuple[object, ...], list[_Item]] = defaultdict(list)
        for array, target, position in jobs:
            item = _Item(array, target, position, self._pieces(array, position))
            groups[item.kind].append(item)
        for group in groups.values():
            blocks = _blocks(self._targeted(sorted(group, key=lambda item: item.places)))
            if len(blocks) > _FEW_BLOCKS:  # borders of a grid lie between each other, but look alike
                blocks = min(blocks, _blocks(self._targeted(_by_gaps(group))), key=len)
            for rows in blocks:
                for item in (item for row in rows for item in row if item.array == _STORE):
                    self.slots[item.position] = item.target
                    self.n_slots += 1
                self._write_loop(rows)

    def _write_sines(self, angles: list[int]) -> None:
        """Sines and cosines of angles that stand one after the other in the store."""
        n, first = len(angles), self.n_slots - len(angles)
        for k, operation in enumerate(SINES, 1):
            for angle in angles:
                if (position := self.graph.sines.get((operation, angle))) is not None:
                    self.slots[position] = self.slots[angle] + k * n
        self.n_slots += 2 * n
        self.lines.append(f"sines({n}, {_STORE} + {first}, {_STORE} + {first + n}, {_STORE} + {first + 2 * n});")

    def _targeted(self, items: list[_Item]) -> list[_Item]:
        """Items in their order; those whose value is stored go into the next free slots."""
        free = self.n_slots
        return [item._replace(target=free + k) if item.array == _STORE else item for k, item in enumerate(items)]

    def _pieces(self, array: str, position: int) -> tuple[_Piece, ...]:
        """What a value is the sum of: the terms of a long sum, or the one expression that it is."""
        if position in self.sums and (array == _STORE or position not in self.stored):
            terms = [(operation, self._reference(term)) for operation, term in self.sums[position]]
        else:
            terms = [(ca.OP_ADD, self.trees[position] if array == _STORE else self._reference(position))]
        placed = [(op, tree.shape, *self._places(tree)) for op, tree in terms]
        pieces = []
        for run in _runs(placed, lambda term: (term[0], term[1], len(term[2])), lambda term: term[2]):
            (operation, shape, places, _), strides = run[0], (0,) * len(run[0][2])
            if len(run) > 1:
                strides = _difference(run[1][2], places)
            constants = tuple(zip(*(term[3] for term in run), strict=True))
            pieces.append(_Piece(operation, shape, len(run), places, strides, constants))
        return tuple(pieces)

    def _places(self, tree: _Tree) -> tuple[tuple[int, ...], tuple[float, ...]]:
        """Places of a tree's operands in their arrays, and its constants."""
        places, constants = [], []
        for leaf in tree.leaves:
            node = self.graph.nodes[leaf]
            if node.operation == ca.OP_CONST:
                constants.append(node.value)
            else:
                places.append(node.operands[1] if node.is_leaf else self.slots[leaf])
        return tuple(places), tuple(constants)

    # C

    def _write_loop(self, rows: list[list[_Item]]) -> None:
        """One or two loops over items: rows at equal distances, in each of which the items are."""
        first = rows[0][0]
        along_j = _difference(rows[-1][0].places, first.places, len(rows) - 1)
        along_i = _difference(rows[0][-1].places, first.places, len(rows[0]) - 1)
        places = [_Place(*p) for p in zip(first.places, along_j, along_i, strict=True)]
        target = places.pop().element(first.array)
        loop_j, loop_i = _loop("j", len(rows)), _loop("i", len(rows[0]))
        expressions = []
        for number, piece in enumerate(first.pieces):
            own, places = places[: len(piece.places)], places[len(piece.places) :]
            constants = [
                _Constants([values for row in rows for item in row for values in (item.pieces[number].constants[q],)])
                for q in range(len(piece.constants))
            ]
            expressions.append((piece, own, constants))
        if not first.is_sum:
            piece, own, constants = expressions[0]
            self.lines.append(
                f"{loop_j}{loop_i}{target} = {without_parentheses(self._text(piece, own, constants, len(rows[0])))};"
            )
            return
        total, size = ("total[i]", f"[{len(rows[0])}]") if loop_i else ("total", "")
        lines = [f"double total{size};"]
        for number, (piece, own, constants) in enumerate(expressions):
            start = 0
            if number == 0:
                lines.append(f"{loop_i}{total} = {self._text(piece, own, constants)};")
                start = 1
            if piece.n_terms > 1:
                text = applied(piece.operation, [total, self._text(piece, own, constants, term="k")], self.graph.name)
                lines.append(f"for (int k = {start}; k < {piece.n_terms}; k++) {loop_i}{total} = {text};")
            elif number > 0:
                text = applied(piece.operation, [total, self._text(piece, own, constants)], self.graph.name)
                lines.append(f"{loop_i}{total} = {text};")
        lines.append(f"{loop_i}{target} = {total};")
        self.lines += ["{", *(f"    {line}" for line in lines), "}"]

    def _text(
        self, piece: _Piece, places: list[_Place], constants: list[_Constants], row: int = 0, term: str = ""
    ) -> str:
        """The expression of a piece, of its first term or of term `term`."""
        next_place = iter(zip(places, piece.strides, strict=True))
        next_constant = iter(constants)

        def written(number: int) -> str:
            shape = self.shapes[number]
            if shape[0] == _CONSTANT:
                return next(next_constant).element(self.tables, row, term)
            if isinstance(shape[0], str):
                place, stride = next(next_place)
                return shape[0] if shape[0] in SCALARS else place.element(shape[0], (term, stride))
            operands = [written(int(str(operand))) for operand in shape[1:]]
            return f"({applied(int(str(shape[0])), operands, self.graph.name)})"

        return written(piece.shape)


@dataclass(frozen=True)
class _Place:
    """Where an operand lies: a number, and its distances in both loops."""

    first: int
    along_j: int
    along_i: int

    def element(self, array: str, further: tuple[str, int] = ("", 0)) -> str:
        """The element of an array as C."""
        parts = [
            name if stride == 1 else f"{stride} * {name}"
            for name, stride in (("j", self.along_j), ("i", self.along_i), further)
            if name and stride
        ]
        if self.first or not parts:
            parts.insert(0, str(self.first))
        return f"{array}[{' + '.join(parts)}]"


@dataclass(frozen=True)
class _Constants:
    """A constant of an expression: its values by item, then by term."""

    values: list[tuple[float, ...]]

    def element(self, tables: Tables, row: int, term: str) -> str:
        """A literal where all are equal, else an element of a table."""
        by_item = [tuple(v.hex() for v in values) for values in self.values]
        if all(v == by_item[0][0] for values in by_item for v in (values if term else values[:1])):
            return operand(self.values[0][0])
        n, terms = len(by_item), len(by_item[0])
        if all(values == by_item[0] for values in by_item):
            return f"{tables.name(self.values[0])}[{term or 0}]"
        name = tables.name(self.values[i][k] for k in range(terms) for i in range(n))
        item = "i" if row in (0, n) else f"{row} * j + i"
        return f"{name}[{n} * {term} + {item}]" if term else f"{name}[{item}]"


def _levels(needs: Mapping[int, set[int]], whole: Mapping[int, int]) -> dict[int, int]:
    """How many values have to come before each, where those with one name in `whole` come together.

    Those that wait for each other are left out.
    """
    waits: dict[int, set[int]] = defaultdict(set)
    for position, operands in needs.items():
        unit = whole.get(position, position)
        waits[unit] |= {whole.get(i, i) for i in operands} - {unit}
    users: dict[int, list[int]] = defaultdict(list)
    for unit, operands in waits.items():
        for operand_unit in operands:
            users[operand_unit].append(unit)
    levels = {unit: 0 for unit, operands in waits.items() if not operands}
    ready, missing = list(levels), {unit: len(operands) for unit, operands in waits.items()}
    for unit in ready:  # which grows
        for user in users[unit]:
            missing[user] -= 1
            if not missing[user]:
                levels[user] = 1 + max(levels[i] for i in waits[user])
                ready.append(user)
    return levels | {position: levels[unit] for position, unit in whole.items() if unit in levels}


def _loop(name: str, n: int) -> str:
    return f"for (int {name} = 0; {name} < {n}; {name}++) " if n > 1 else ""


def _difference(a: Sequence[int], b: Sequence[int], over: int = 1) -> tuple[int, ...]:
    """Distances between two lists of places, by the number of steps between them."""
    if over <= 1:
        return tuple(map(sub, a, b))
    return tuple((x - y) // over for x, y in zip(a, b, strict=True))


def _distances(run: list[_Item]) -> tuple[object, ...]:
    return len(run), len(run) > 1 and _difference(run[1].places, run[0].places)


def _by_gaps(items: list[_Item]) -> list[_Item]:
    """Items sorted by the distances between their operands, then by where these lie."""
    columns = zip(*(item.places[:-1] for item in items), strict=True)
    moving = [k for k, column in enumerate(columns) if len(set(column)) > 1]

    def gaps(item: _Item) -> list[int]:
        return [item.places[k] - item.places[moving[0]] for k in moving]

    return sorted(items, key=lambda item: (gaps(item), item.places))


def _blocks(items: list[_Item]) -> list[list[list[_Item]]]:
    """Items of one kind in their order, as what one statement computes: rows at equal distances, of items likewise."""
    runs = _runs(items, lambda item: None, lambda item: item.places)
    blocks = []
    for rows in _runs(runs, _distances, lambda run: run[0].places, shortest=2):
        apart = len(rows[0]) == 1 or rows[0][0].is_sum
        blocks += [[row] for row in rows] if apart else [rows]
    return blocks


def _runs(
    items: Sequence[_T],
    kind: Callable[[_T], object],
    places: Callable[[_T], tuple[int, ...]],
    shortest: int = _SHORTEST,
) -> list[list[_T]]:
    """Items in their order, those together that are of one kind and lie at equal distances; shorter runs are single."""
    runs, i = [], 0
    where, kinds = [places(item) for item in items], [kind(item) for item in items]
    while i < len(items):
        end = i + 1
        if end < len(items) and kinds[end] == kinds[i]:
            distance = _difference(where[end], where[i])
            while end < len(items) and kinds[end] == kinds[i] and _difference(where[end], where[end - 1]) == distance:
                end += 1
        if end - i < shortest:
            end = i + 1
        runs.append(list(items[i:end]))
        i = end
    return runs


def _sums(graph: Graph) -> tuple[dict[int, list[tuple[int, int]]], set[int]]:
    """Long sums and the like: by node of the total its terms, each with its operation; then nodes of partial ones."""
    sums: dict[int, list[tuple[int, int]]] = {}
    inner: set[int] = set()

    for head in reversed(range(len(graph.nodes))):
        if graph.nodes[head].operation not in _SUMS or head in inner:
            continue
        kind = _SUMS[graph.nodes[head].operation]

        def is_partial(position: int, kind: int = kind) -> bool:
            return _SUMS.get(graph.nodes[position].operation) == kind and graph.uses[position] == 1

        position, terms, partial = head, [], []
        while True:
            operation, (a, b) = graph.nodes[position].operation, graph.nodes[position].operands
            if operation in _COMMUTATIVE and is_partial(b) and not is_partial(a):
                a, b = b, a
            terms.append((operation, b))
            if not is_partial(a):
                break
            position = a
            partial.append(a)
        terms.append((kind, a))
        if len(terms) >= _FEWEST_TERMS:
            sums[head] = terms[::-1]
            inner.update(partial)
    return sums, inner
