"""The tables by which the C adapter knows types and arrays; a model of real scalars has none."""

from __future__ import annotations

from typing import get_args

from fmu_export.modelling.variables import Type
from fmu_export.native.expressions import c_string
from fmu_export.package.interface import Interface

#: As in the C: positions are the numbers of the types.
_TYPES = get_args(Type)

_DECLARATIONS = """
typedef struct {
    int n;
    const int *values;
    const char *const *texts;
} ModelItems;
extern const int model_types[N_P + N_U + N_Y + N_X + 1];
extern const ModelItems model_items[N_P + N_U + N_Y + 1]; /* of enumerations and strings */
"""


def number_of_typed(interface: Interface) -> int:
    """How many scalar variables are no reals."""
    return sum(v.type != "real" for v in interface.variables)


def declarations(interface: Interface) -> str:
    """What stands in `model.h`."""
    lengths = "extern const unsigned model_lengths[N_P + N_U + N_Y + N_X + 1]; /* 0 of what is within an array */\n"
    return (_DECLARATIONS if number_of_typed(interface) else "") + (lengths if interface.arrays else "")


def definitions(interface: Interface) -> str:
    """What stands in `model.c`."""
    return (_types(interface) if number_of_typed(interface) else "") + (_lengths(interface) if interface.arrays else "")


def _lengths(interface: Interface) -> str:
    n = {entry.reference: len(entry.elements) for entry in (*interface.entries, *interface.derivative_entries)}
    lengths = "".join(f"{n.get(i, 0)}, " for i in range(len(interface.variables) + len(interface.derivatives)))
    return f"const unsigned model_lengths[N_P + N_U + N_Y + N_X + 1] = {{{lengths}1}};\n\n"


def _types(interface: Interface) -> str:
    types = "".join(f"{_TYPES.index(v.type)}, " for v in interface.variables) + "0, " * len(interface.derivatives)
    numbers = {items: i for i, items in enumerate(dict.fromkeys(v.items for v in interface.variables if v.items))}
    lists = "".join(
        f"static const int item_values_{i}[] = {{{', '.join(str(value) for _, value in items)}}};\n"
        f"static const char *const item_texts_{i}[] = {{{', '.join(c_string(text) for text, _ in items)}}};\n"
        for items, i in numbers.items()
    )
    entries = "".join(
        f"{{{len(v.items)}, item_values_{numbers[v.items]}, item_texts_{numbers[v.items]}}}, "
        if v.items
        else "{0, 0, 0}, "
        for v in interface.variables
    )
    return (
        f"const int model_types[N_P + N_U + N_Y + N_X + 1] = {{{types}0}};\n{lists}"
        f"const ModelItems model_items[N_P + N_U + N_Y + 1] = {{{entries}{{0, 0, 0}}}};\n\n"
    )
