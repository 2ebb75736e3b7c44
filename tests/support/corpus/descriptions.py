"""FMUs whose model description is not XML, hostile XML, or not what the standard has."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

from tests.support.corpus.case import (
    DESCRIPTION_1,
    DESCRIPTION_2,
    DESCRIPTION_3,
    LIBRARY,
    REFUSED,
    RUNS,
    Case,
    Materials,
    fmu_2,
    members_3,
    replaced,
    zipped,
)


def _xml(
    name: str,
    xml: str | bytes | Callable[[], str | bytes],
    says: str = "",
    expected: str = REFUSED,
    is_valid: bool | None = None,
) -> Case:
    """The FMU of FMI 2.0 with another description."""
    return Case(
        name, lambda folder, m: fmu_2(folder, m, xml() if callable(xml) else xml), expected, says,
        is_valid=is_valid,
    )  # fmt: skip


def _2(name: str, before: str, after: str, says: str = "", expected: str = REFUSED, *, is_valid: bool = False) -> Case:
    """The FMU of FMI 2.0 with a replacement in its description."""
    return Case(
        f"FMI 2.0: {name}",
        lambda folder, m: fmu_2(folder, m, replaced(DESCRIPTION_2, before, after)),
        expected,
        says,
        is_valid=is_valid,
    )


def _3(name: str, before: str, after: str, says: str = "", expected: str = REFUSED, *, is_valid: bool = False) -> Case:
    """The FMU of FMI 3.0 with a replacement in its description."""
    return Case(
        f"FMI 3.0: {name}",
        lambda folder, m: zipped(folder / "x.fmu", *members_3(m, replaced(DESCRIPTION_3, before, after))),
        expected,
        says,
        is_valid=is_valid,
    )


def _1(name: str, before: str, after: str, says: str = "") -> Case:
    def make(folder: Path, materials: Materials) -> Path:
        xml = replaced(DESCRIPTION_1, before, after) if before else DESCRIPTION_1
        return zipped(folder / "x.fmu", ("modelDescription.xml", xml.encode()), (LIBRARY, materials.fmi2))

    return Case(f"FMI 1.0: {name}", make, REFUSED, says, arguments=("--stop", "1", "--step", "0.1"))


def _variables(number: int) -> str:
    more = "".join(
        f'<ScalarVariable name="v{k}" valueReference="{k % 50 + 3}" causality="local"><Real/></ScalarVariable>'
        for k in range(number)
    )
    return replaced(DESCRIPTION_2, "</ModelVariables>", f"{more}</ModelVariables>")


def _laughs(place: str) -> str:
    entities = '<!ENTITY l0 "lol">' + "".join(f'<!ENTITY l{k} "{f"&l{k - 1};" * 10}">' for k in range(1, 11))
    return replaced(DESCRIPTION_2, "<fmiModelDescription", f"<!DOCTYPE f [{entities}]><fmiModelDescription").replace(
        *place.split(" => ")
    )


_U = '<ScalarVariable name="u" valueReference="1" causality="input"><Real start="1"/></ScalarVariable>'
_Y = '<ScalarVariable name="y" valueReference="2" causality="output"><Real/></ScalarVariable>'
_A = '<Float64 name="a" valueReference="2" causality="input" start="0">'
_UNITS = "<UnitDefinitions><Unit name='m'><BaseUnit {}/></Unit></UnitDefinitions><ModelVariables>"
_TYPES = "<TypeDefinitions>{}</TypeDefinitions><ModelVariables>"
_EXPERIMENT = '<DefaultExperiment startTime="0" stopTime="1" stepSize="0.1"/>'
_END = "</ModelVariables>"
_SIZES = ("1000000", "10000000000", "18446744073709551615", "99999999999999999999999", "-3", "-0.5", "three", "", "1e3")


def _latin(text: str, encoding: str) -> bytes:
    return text.replace("UTF-8", encoding).replace("Stranger", "Fremdkörper").encode(encoding)


DESCRIPTIONS: tuple[Case, ...] = (
    # XML
    _xml("a description that is empty", "", "Document is empty"),
    _xml("a description of spaces", "   \n", "is not readable as XML"),
    _xml("a description that is a text", "hello", "is not readable as XML"),
    _xml("a description that is JSON", '{"fmiVersion": "2.0"}', "is not readable as XML"),
    _xml("a description cut off", DESCRIPTION_2[:300], "is not readable as XML"),
    _xml("an element that is not closed", DESCRIPTION_2.replace("</ModelStructure>", ""), "is not readable as XML"),
    _xml("two root elements", DESCRIPTION_2 + "<again/>", "is not readable as XML"),
    _xml("bytes that are not UTF-8", DESCRIPTION_2.encode().replace(b"Stranger", b"\xff\xfe"), "is not readable as XML"),
    _xml("a NUL", DESCRIPTION_2.encode().replace(b"Stranger", b"a\0b"), "is not readable as XML"),
    _xml("a control character", DESCRIPTION_2.replace("Stranger", "a\x1b[2Jb"), "is not readable as XML"),
    _xml("a control character by its number", DESCRIPTION_2.replace("Stranger", "&#27;[2J"), "is not readable as XML"),
    _xml("an unknown encoding", DESCRIPTION_2.replace("UTF-8", "x-none"), "is not readable as XML"),
    _xml("another encoding than it says", DESCRIPTION_2.replace("UTF-8", "UTF-16"), "is not readable as XML"),
    _xml("UTF-16", lambda: DESCRIPTION_2.replace("UTF-8", "UTF-16").encode("utf-16"), expected=RUNS),
    _xml("UTF-8 with a byte order mark", lambda: DESCRIPTION_2.encode("utf-8-sig"), expected=RUNS),
    _xml("ISO-8859-1", lambda: _latin(DESCRIPTION_2, "ISO-8859-1"), expected=RUNS),
    _xml("windows-1252", lambda: _latin(DESCRIPTION_2, "windows-1252"), expected=RUNS),
    _xml("no XML declaration", DESCRIPTION_2.partition("\n")[2], expected=RUNS),
    _xml("comments everywhere", DESCRIPTION_2.replace("><", "><!-- & --><").replace(">\n<", ">\n<!-- x --><"), expected=RUNS),
    _xml("processing instructions", DESCRIPTION_2.replace("<ModelVariables>", "<ModelVariables><?php die?>"), expected=RUNS),
    _xml("texts between elements", DESCRIPTION_2.replace("<Outputs>", "<![CDATA[x]]><Outputs>"), "", RUNS, is_valid=False),
    _xml("a document type alone", DESCRIPTION_2.replace("?>\n", "?>\n<!DOCTYPE fmiModelDescription>\n", 1), "DOCTYPE"),
    _xml("a billion laughs", lambda: _laughs("<Outputs> => <Outputs>&l9;"), "modelDescription.xml"),
    _xml("a billion laughs in an attribute", lambda: _laughs("Stranger => &l9;"), "modelDescription.xml"),
    _xml(
        "a file of the system as an entity",
        DESCRIPTION_2.replace("?>\n", '?>\n<!DOCTYPE f [<!ENTITY x SYSTEM "file:///etc/passwd">]>\n', 1).replace(
            "<Outputs>", "<Outputs>&x;"
        ),
        "DOCTYPE",
    ),
    _xml(
        "a DTD of another machine",
        DESCRIPTION_2.replace("?>\n", '?>\n<!DOCTYPE f SYSTEM "http://127.0.0.1:9/x.dtd">\n', 1),
        "DOCTYPE",
    ),
    _xml(
        "an entity that is never used", DESCRIPTION_2.replace("?>\n", '?>\n<!DOCTYPE f [<!ENTITY x "y">]>\n', 1), "DOCTYPE"
    ),
    _xml("100,000 nested elements", lambda: "<a>" * 100_000 + "</a>" * 100_000, "is not readable as XML"),
    _xml(
        "200 nested elements",
        lambda: DESCRIPTION_2.replace("<Outputs>", "<a>" * 200 + "</a>" * 200 + "<Outputs>"),
        "nested more than 100 times",
    ),
    _xml("an attribute of 20 MB", lambda: DESCRIPTION_2.replace("Stranger", "x" * 20_000_000), "is not readable as XML"),
    _xml("a name of 1 MB", lambda: DESCRIPTION_2.replace('name="y"', f'name="{"y" * 1_000_000}"'), expected=RUNS),
    _xml(
        "200,000 attributes",
        lambda: DESCRIPTION_2.replace("<CoSimulation", "<CoSimulation " + " ".join(f'a{k}=""' for k in range(200_000))),
        expected=RUNS,
        is_valid=False,
    ),
    _xml("a root of HTML", "<html><body/></html>", "its root element is 'html'"),
    _xml("a root of SSP", "<SystemStructureDescription/>", "its root element is"),
    _xml("elements in a namespace", DESCRIPTION_2.replace("fmiVersion", 'xmlns="urn:x" fmiVersion', 1), "in the namespace"),
    _xml(
        "attributes in a namespace",
        DESCRIPTION_2.replace("fmiVersion", 'xmlns:x="urn:x" x:a="1" fmiVersion', 1).replace("<Real ", '<Real x:b="2" '),
        expected=RUNS,
        is_valid=False,
    ),
    _xml("a model of 20,000 variables", lambda: _variables(20_000), expected=RUNS),
    _xml(
        "20,000 variables, each of them wrong",
        lambda: _variables(20_000).replace('" valueReference="', '" valueReference="-9'),
        "not a whole number below 2^32",
    ),
    _xml(
        "20,000 variables of one name",
        lambda: re.sub('name="v[0-9]+"', 'name="v"', _variables(20_000)).replace("local", "output"),
        "there are two variables named 'v'",
    ),
    # versions and interfaces
    _2("no version", 'fmiVersion="2.0" ', "", "it has no fmiVersion"),
    _2("version 2.5", '"2.0"', '"2.5"', "it is of FMI '2.5'"),
    _2("version 4.0", '"2.0"', '"4.0"', "it is of FMI '4.0'"),
    _2("version abc", '"2.0"', '"abc"', "it is of FMI 'abc'"),
    _2("version of a draft", '"2.0"', '"3.0-beta.2"', ""),
    _2("version with an escape", '"2.0"', '"2.0&#10;"', "it is of FMI"),
    _2("no GUID", ' guid="{GUID}"', "", "it has no guid"),
    _2("an empty GUID", '"{GUID}"', '""', expected=RUNS, is_valid=True),
    _2("no name", 'modelName="Stranger" ', "", expected=RUNS),
    _2("no interface", "<CoSimulation ", "<Nothing ", "has no co-simulation interface"),
    _2("no identifier", 'modelIdentifier="stranger" ', "", "CoSimulation has no modelIdentifier"),
    _2("an empty identifier", '"stranger"', '""', "CoSimulation has no modelIdentifier"),
    _2("an identifier that is a path", '"stranger"', '"../../../x"', "is not a name of a library"),
    _2("an identifier with an escape", '"stranger"', '"a&#9;b"', ""),
    _2("another identifier", '"stranger"', '"other"', "which its model identifier asks for"),
    _2("two interfaces of a kind", "<DefaultExperiment", '<CoSimulation modelIdentifier="b"/><DefaultExperiment',
       "a second CoSimulation"),
    _2("an order that is not a number", "<CoSimulation ", '<CoSimulation maxOutputDerivativeOrder="many" ',
       "is not a whole number"),
    _2("a number of indicators that is none", "guid=", 'numberOfEventIndicators="x" guid=', "is not a whole number"),
    _2("a capability that is no truth value", "<CoSimulation ", '<CoSimulation canInterpolateInputs="perhaps" ',
       expected=RUNS),
    # the experiment
    _2("a stop that is not a number", 'stopTime="1"', 'stopTime="soon"', "which is not a number"),
    _2("a stop that is NaN", 'stopTime="1"', 'stopTime="NaN"', "which is not a number"),
    _2("a stop that is infinite", 'stopTime="1"', 'stopTime="INF"', "which is not a number"),
    _2("a stop beyond all numbers", 'stopTime="1"', 'stopTime="1e999"', "which is not a number"),
    _2("a stop before the start", 'stopTime="1"', 'stopTime="-1"', expected=RUNS),
    _2("a step of nothing", 'stepSize="0.1"', 'stepSize="0"', expected=RUNS),
    _2("a negative step", 'stepSize="0.1"', 'stepSize="-0.1"', expected=RUNS),
    _2("a step of 1e-300", 'stepSize="0.1"', 'stepSize="1e-300"', "step", is_valid=True),
    _2("a tolerance that is not a number", _EXPERIMENT, '<DefaultExperiment stopTime="1" stepSize="0.1" tolerance="x"/>',
       expected=RUNS),
    _2("a tolerance of NaN", _EXPERIMENT, '<DefaultExperiment stopTime="1" stepSize="0.1" tolerance="NaN"/>',
       expected=RUNS, is_valid=True),
    # variables
    _2("no ModelVariables", "ModelVariables>", "Variables>", "it has no ModelVariables"),
    _2("no ModelStructure", "ModelStructure>", "Structure>", expected=RUNS),
    _2("a variable without a name", ' name="y"', "", "a variable has no name"),
    _2("a variable with an empty name", ' name="y"', ' name=""', ""),
    _2("a variable without a type", "<Real/>", "", "has no type"),
    _2("a variable of an unknown type", "<Real/>", "<Complex/>", "has no type"),
    _2("a variable of a type of FMI 3.0", "<Real/>", "<Float64/>", "has no type"),
    _2("no value reference", 'valueReference="2" ', "", "which is not a whole number below 2^32"),
    _2("a value reference of 2^32 + 1", '"2"', '"4294967297"', "which is not a whole number below 2^32"),
    _2("a value reference of 2^33 + 4", '"2"', '"8589934596"', "which is not a whole number below 2^32"),
    _2("a value reference of 2^64 + 2", '"2"', '"18446744073709551618"', "which is not a whole number below 2^32"),
    _2("a negative value reference", 'valueReference="2"', 'valueReference="-2"', "not a whole number below 2^32"),
    _2("a value reference that is not a number", 'valueReference="2"', 'valueReference="two"', "not a whole number"),
    _2("a value reference of 2.0", 'valueReference="2"', 'valueReference="2.0"', "not a whole number"),
    _2("a value reference with a digit of another script", 'valueReference="2"', 'valueReference="٢"', "not a whole number"),
    _2("the greatest value reference", 'valueReference="1"', 'valueReference="4294967295"', expected=RUNS, is_valid=True),
    _2("a variable twice", _U, _U + _U, expected=RUNS),
    _2("two variables of one name", _Y, _Y + _Y.replace('"2"', '"3"'), "there are two variables named 'y'"),
    _2("three variables of one name", _Y, _Y + _Y.replace('"2"', '"3"') + _Y.replace('"2"', '"4"'), "variables named 'y'"),
    _2("two variables of one name and two types", _Y, _Y + _Y.replace("<Real/>", "<Integer/>"), "variables named 'y'"),
    _2("two locals of one name", _Y, _Y + "".join(
        f'<ScalarVariable name="l" valueReference="{k}" causality="local"><Real/></ScalarVariable>' for k in (5, 6)),
       expected=RUNS),
    _2("an input of the name of an output", 'name="u"', 'name="y"', "there are two variables named 'y'"),
    _2("an unknown causality", '"output"', '"outcome"', ""),
    _2("an unknown variability", 'causality="output"', 'causality="output" variability="wild"', ""),
    _2("a start value that is not a number", 'start="1"', 'start="one"', expected=RUNS),
    _2("a start value of NaN", 'start="1"', 'start="NaN"', expected=RUNS, is_valid=True),
    _2("a start value beyond all numbers", 'start="1"', 'start="1e999"', expected=RUNS, is_valid=True),
    _2("a start value with a comma", 'start="1"', 'start="1,5"', expected=RUNS),
    _2("an integer beyond 32 bits", '<Real start="1"/>', '<Integer start="99999999999"/>', expected=RUNS),
    _2("bounds the wrong way round", '<Real start="1"/>', '<Real start="1" min="3" max="-3"/>', expected=RUNS, is_valid=True),
    _2("a bound that is not a number", '<Real start="1"/>', '<Real start="1" min="low"/>', expected=RUNS),
    _2("a nominal of nothing", '<Real start="1"/>', '<Real start="1" nominal="0"/>', expected=RUNS, is_valid=True),
    _2("an unknown declared type", "<Real/>", '<Real declaredType="T"/>', "which has not been defined"),
    _2("an unknown unit", "<Real/>", '<Real unit="furlong"/>', expected=RUNS),
    _2("a derivative of nothing", "<Real/>", '<Real derivative="77"/>', "refers to variable '77'"),
    _2("a derivative of itself", "<Real/>", '<Real derivative="2"/>', expected=RUNS, is_valid=True),
    _2("a negative derivative", "<Real/>", '<Real derivative="-1"/>', "refers to variable '-1'"),
    _2("a name with an escape code of a terminal", 'name="y"', 'name="&#155;31my&#x202e;"', expected=RUNS),
    _2("a name with a line break", 'name="y"', 'name="y&#10;cosim: ok"', expected=RUNS),
    _2("a name with dots and slashes", 'name="y"', 'name="../../y"', expected=RUNS, is_valid=True),
    _2("a description with an escape code", 'name="y"', 'name="y" description="&#155;2J"', expected=RUNS, is_valid=True),
    # structure
    _2("an index beyond the variables", '<Unknown index="2" dependencies=""/></Outputs>', '<Unknown index="9"/></Outputs>',
       "refers to variable '9'"),
    _2("an index of 0", '<Unknown index="2" dependencies=""/></Outputs>', '<Unknown index="0"/></Outputs>',
       "refers to variable '0'"),
    _2("a negative index", '<Unknown index="2" dependencies=""/></Outputs>', '<Unknown index="-1"/></Outputs>',
       "refers to variable '-1'"),
    _2("no index", '<Unknown index="2" dependencies=""/></Outputs>', "<Unknown/></Outputs>", "refers to variable ''"),
    _2("a dependency on variable 0", 'dependencies=""/></Outputs>', 'dependencies="0"/></Outputs>', "variable '0'"),
    _2("a dependency that is not a number", 'dependencies=""/></Outputs>', 'dependencies="u"/></Outputs>', "variable 'u'"),
    _2("dependencies with many spaces", 'dependencies=""/></Outputs>', 'dependencies="  1   1 "/></Outputs>', expected=RUNS,
       is_valid=True),
    _2("kinds without dependencies", 'dependencies=""/></Outputs>', 'dependenciesKind="dependent"/></Outputs>',
       expected=RUNS),
    # units and types
    _2("a unit with a factor of NaN", "<ModelVariables>", _UNITS.format('m="1" factor="NaN"'), "no value can be converted"),
    _2("a unit with a factor of 0", "<ModelVariables>", _UNITS.format('m="1" factor="0"'), "no value can be converted"),
    _2("a unit with an infinite factor", "<ModelVariables>", _UNITS.format('m="1" factor="1e999"'), "can be converted"),
    _2("a unit with an offset of NaN", "<ModelVariables>", _UNITS.format('m="1" offset="NaN"'), "can be converted"),
    _2("a unit with an exponent of 1.5", "<ModelVariables>", _UNITS.format('m="1.5"'), "is not a whole number"),
    _2("a unit with an exponent of 10^30", "<ModelVariables>", _UNITS.format(f'm="{10**30}"'), "is not a whole number"),
    _2("a unit twice", "<ModelVariables>", _UNITS.format('m="1"').replace("<Unit ", "<Unit name='m'/><Unit "),
       expected=RUNS),
    _2("a type without an element", "<ModelVariables>", _TYPES.format('<SimpleType name="T"/>'), "which it is"),
    _2("an item without a value", "<ModelVariables>",
       _TYPES.format('<SimpleType name="T"><Enumeration><Item name="a"/></Enumeration></SimpleType>'),
       "is not a whole number"),
    _2("an item of 1.5", "<ModelVariables>",
       _TYPES.format('<SimpleType name="T"><Enumeration><Item name="a" value="1.5"/></Enumeration></SimpleType>'),
       "is not a whole number"),
    _2("a type with an unknown attribute", "<ModelVariables>",
       _TYPES.format('<SimpleType name="T"><Real colour="red"/></SimpleType>'), expected=RUNS),
    _2("a type twice", "<ModelVariables>",
       _TYPES.format('<SimpleType name="T"><Real/></SimpleType><SimpleType name="T"><Integer/></SimpleType>'),
       expected=RUNS),
    # FMI 3.0
    Case("FMI 3.0: the FMU as it is", lambda folder, m: zipped(folder / "x.fmu", *members_3(m)), RUNS),
    _3("no token", ' instantiationToken="3"', "", "it has no instantiationToken"),
    *(
        _2(f"elements of {what}", _END, "".join(
            f'<ScalarVariable name="v{index}" valueReference="{9 + k}" causality="local"><Real/></ScalarVariable>'
            for k, index in enumerate(indices)) + _END, expected=RUNS, is_valid=True)
        for what, indices in (
            ("places far apart", ("[1]", f"[{10**12}]")),
            ("an index of 5,000 digits", (f"[{'9' * 5000}]",)),
            ("places below 1", ("[0]", "[-1]")),
            ("several dimensions", ("[1]", "[1,2]", "[2][1]", "")),
        )
    ),
    _3("a type of FMI 2.0", "<Float64 name=\"b\"", "<Real name=\"b\"", ""),
    _3("no value reference", 'name="time" valueReference="0"', 'name="time"', "not a whole number below 2^32"),
    _3("a value reference of 2^32 + 2", 'name="b" valueReference="3"', 'name="b" valueReference="4294967299"', "2^32"),
    _3("a value reference twice", 'name="time" valueReference="0"', 'name="time" valueReference="2"', expected=RUNS),
    _3("a size by two variables", 'name="time" valueReference="0"', 'name="time" valueReference="1"', "2 variables have"),
    _3("two variables of one name", 'name="time"', 'name="b"', "there are two variables named 'b'"),
    _3("an alias of the name of another", '<Dimension valueReference="1"/></Float64>\n</ModelVariables>',
       '<Dimension valueReference="1"/><Alias name="b"/><Alias name="a"/></Float64>\n</ModelVariables>',
       "there are two variables named"),
    _3("a dimension of nothing", _A + '<Dimension valueReference="1"/>', _A + "<Dimension/>", "either start or valueRef"),
    _3("a dimension by both", _A + '<Dimension valueReference="1"/>', _A + '<Dimension valueReference="1" start="3"/>',
       "either start or valueReference"),
    _3("a dimension by no variable", _A + '<Dimension valueReference="1"/>', _A + '<Dimension valueReference="77"/>',
       "which no variable has"),
    _3("a dimension by a real number", _A + '<Dimension valueReference="1"/>', _A + '<Dimension valueReference="0"/>',
       "is not a single whole number"),
    _3("a dimension by itself", _A + '<Dimension valueReference="1"/>', _A + '<Dimension valueReference="2"/>',
       "is not a single whole number"),
    _3("dimensions in a circle", 'variability="fixed" start="3"/>',
       'variability="fixed" start="3"><Dimension valueReference="1"/></UInt64>', "is not a single whole number"),
    _3("a size without a start value", 'variability="fixed" start="3"', 'variability="fixed"', "which is not a size"),
    *(
        _3(f"an input of {size or 'no'} elements", _A + '<Dimension valueReference="1"/>',
           _A + f'<Dimension start="{size}"/>', "more than can be read" if size in _SIZES[1:3] else "which is not a size")
        for size in _SIZES[1:]
    ),
    _3("a size of 10^10 by a parameter", 'variability="fixed" start="3"', 'variability="fixed" start="10000000000"',
       "more than can be read"),
    _3("a negative size by a parameter", 'variability="fixed" start="3"', 'variability="fixed" start="-3"', "is not a size"),
    _3("10^4 times 10^4 times 10^4 elements", _A + '<Dimension valueReference="1"/>', _A + '<Dimension start="10000"/>' * 3,
       "more than can be read"),
    _3("an array of nothing", _A + '<Dimension valueReference="1"/>', _A + '<Dimension start="0"/>', expected=RUNS, is_valid=True),
    _3("a clock of no variable", 'name="a" valueReference="2"', 'name="a" clocks="77" valueReference="2"', "variable '77'"),
    _3("an output of no variable", '<Output valueReference="3"/>', '<Output valueReference="33"/>', "variable '33'"),
    _3("dependencies on no variable", '<Output valueReference="3"/>', '<Output valueReference="3" dependencies="9 9"/>',
       "refers to variable '9'"),
    _3("a version of a draft", '"3.0"', '"3.0-rc.2"', "a draft with other functions"),
    _3("version 3.1", '"3.0"', '"3.1"', expected=RUNS, is_valid=True),
    _3("an interval that is not a number", "<CoSimulation ", '<CoSimulation fixedInternalStepSize="short" ',
       "is not a finite number"),
    _3("start values that are fewer", 'causality="input" start="0"', 'causality="input" start="0 1"', expected=RUNS),
    *(
        _3(f"a start value that is {what}", _END, f'<{kind} name="z" valueReference="20" causality="parameter" '
           f'variability="fixed"{more}</{kind}>{_END}', expected=RUNS)
        for what, kind, more in (
            ("a Boolean of 2", "Boolean", ' start="2">'),
            ("beyond 8 bits", "Int8", ' start="1000">'),
            ("below an unsigned number", "UInt64", ' start="-1">'),
            ("bytes of an odd number of digits", "Binary", '><Start value="abc"/>'),
            ("bytes of no digits", "Binary", '><Start value="zz"/>'),
        )
    ),
    _3("a dimension by an input", 'causality="structuralParameter" variability="fixed"',
       'causality="input" variability="discrete"', expected=RUNS),
    # FMI 1.0
    _1("a library without its functions", "", "", "lacks stranger_fmiInstantiateSlave"),
    _1("no identifier", ' modelIdentifier="stranger"', "", "it has no modelIdentifier"),
    _1("no implementation", "Implementation>", "Impl>", "has no co-simulation interface"),
    _1("a connection to a tool", "CoSimulation_StandAlone>", "CoSimulation_Tool>", "a connection to a tool"),
    _1("no number of states", ' numberOfContinuousStates="0"', "", ""),
    _1("a number of states that is none", 'numberOfContinuousStates="0"', 'numberOfContinuousStates="x"', "whole number"),
    _1("no variables", "ModelVariables>", "Variables>", "it has no ModelVariables"),
)  # fmt: skip
