from __future__ import annotations

import ast
import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from animtool.rig.expressions import FUNCTIONS, parse_expression

FORBIDDEN = {
    "an attribute": "a.real",
    "an attribute called": "a.__class__()",
    "an index": "a[0]",
    "a slice": "a[:]",
    "a lambda": "lambda: 1",
    "a list": "[a]",
    "a tuple": "a, b",
    "a set": "{a}",
    "a mapping": "{a: 1}",
    "a comprehension": "[a for a in b]",
    "a generator": "max(a for a in b)",
    "a power": "a ** 2",
    "a tower of powers": "9**9**9",
    "floor division": "a // 2",
    "a remainder": "a % 2",
    "a matrix product": "a @ b",
    "a shift": "1 << 99",
    "bits": "a & b",
    "inversion": "~a",
    "not": "not a",
    "and": "a and b",
    "a comparison": "a < b",
    "a condition": "a if b else c",
    "text": "'a'",
    "text times a number": "'a' * 9",
    "bytes": "b'a'",
    "a walrus": "(a := 1)",
    "an f-string": "f'{a}'",
    "a keyword": "clamp(x=1, low=0, high=1)",
    "a keyword beside": "clamp(1, 0, high=1)",
    "stars": "min(*a)",
    "a star that fits": "abs(*a)",
    "two stars": "abs(**a)",
    "true": "True",
    "none": "None",
    "an ellipsis": "...",
    "a complex number": "1j",
    "a number beyond float64": "1e999",
    "a long number": "9" * 500,
    "await": "await a",
    "yield": "(yield)",
    "an unknown function": "eval(a)",
    "an import": "__import__('os')",
    "a call of a call": "abs(a)(b)",
    "a number called": "1(2)",
    "too few": "clamp(a, 0)",
    "too many": "abs(a, b)",
    "none given": "sin()",
    "nothing": "",
    "blanks": "  ",
    "a statement": "a = 1",
    "two lines": "a\nb",
    "an open bracket": "(a",
    "NUL": "a\0",
    "a surrogate": "\ud800",
    "brackets": "(" * 400 + "a" + ")" * 400,
    "signs": "-" * 900 + "a",
    "calls": "abs(" * 100 + "a" + ")" * 100,
    "a sum": "+".join("a" * 200),
    "100 000 characters": "a" + "+a" * 50_000,
}


@pytest.mark.parametrize("name", FORBIDDEN)
def test_what_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match=r"\w"):
        parse_expression(FORBIDDEN[name])


@pytest.mark.parametrize("text", ["1 is 2", "0x1for x", "a is 'b'", "1()", "'\\d'"])
def test_python_does_not_warn_of_what_is_refused(
    text: str, capfd: pytest.CaptureFixture[str]
) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with pytest.raises(ValueError, match=r"\w"):
            parse_expression(text)
    assert not caught
    assert capfd.readouterr().err == ""


def test_names() -> None:
    assert parse_expression("b + sin(a) * pi - b").names == ("a", "b")
    assert parse_expression("1").names == ()


NUMBERS = st.floats(-100, 100)


@given(NUMBERS, NUMBERS, NUMBERS)
def test_values(x: float, y: float, z: float) -> None:
    values = {"x": np.array([x, y]), "y": np.array([y, z]), "z": np.array([z])}
    a, b, c = values["x"], values["y"], values["z"]
    with np.errstate(all="ignore"):
        wanted = {
            "x + y * z - -x": a + b * c + a,
            "x / y": a / b,
            "+x - (y - z)": a - (b - c),
            "abs(x)": np.abs(a),
            "atan2(x, y)": np.arctan2(a, b),
            "ceil(x) + floor(y)": np.ceil(a) + np.floor(b),
            "clamp(x, -1, 1)": np.clip(a, -1, 1),
            "sin(x) + cos(y) + tan(z)": np.sin(a) + np.cos(b) + np.tan(c),
            "exp(x / 100)": np.exp(a / 100),
            "lerp(x, y, z)": a + (b - a) * c,
            "log(x)": np.log(a),
            "max(x, y) + min(x, z)": np.maximum(a, b) + np.minimum(a, c),
            "pow(x, 3)": a**3,
            "sign(x)": np.sign(a),
            "sqrt(x)": np.sqrt(a),
            "2 * pi": np.array(2 * np.pi),
        }
    for text, numbers in wanted.items():
        assert_allclose(parse_expression(text).evaluate(values), numbers, atol=1e-12)


def test_every_function_is_called() -> None:
    for name, (_, arity) in FUNCTIONS.items():
        values = {"x": np.array([0.25, 0.5])}
        found = parse_expression(f"{name}({', '.join(['x'] * arity)})").evaluate(values)
        assert found.shape == (2,)
        assert np.isfinite(found).all()


def test_smoothstep() -> None:
    x = np.array([-1, 0, 0.5, 1, 2])
    wave = parse_expression("smoothstep(0, 1, x)").evaluate({"x": x})
    assert_allclose(wave, [0, 0, 0.5, 1, 1])
    edge = parse_expression("smoothstep(1, 1, x)").evaluate({"x": x})
    assert_allclose(edge, [0, 0, 0, 1, 1])


def test_the_undefined_is_not_finite() -> None:
    for text in ("1 / 0", "log(0)", "sqrt(-1)", "pow(0, -1)", "pi / 0"):
        assert not np.isfinite(parse_expression(text).evaluate({}))


def test_no_memory_is_not_called_a_faulty_expression(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def full(*_given: object, **_named: object) -> None:
        raise MemoryError

    with pytest.raises(ValueError, match="nested deeper"):
        parse_expression("(" * 99 + "1" + ")" * 99)
    monkeypatch.setattr(ast, "parse", full)
    with pytest.raises(MemoryError):
        parse_expression("1")


@pytest.mark.parametrize("text", ["a > 0.5", "a if b else c", "a > 0.5 ? 90 : 0"])
def test_a_condition_names_what_stands_for_it(text: str) -> None:
    with pytest.raises(ValueError, match="smoothstep"):
        parse_expression(text)
