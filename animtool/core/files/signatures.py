"""Detects the format of a file from its first bytes, independent of its name."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any, TypeVar, cast

from animtool.core.errors import Fault, FormatError
from animtool.core.files.reading import FileState, open_input
from animtool.core.names import FILE_KINDS
from animtool.core.record import dataclass

# All of these formats are recognisable within their first bytes.
HEAD_BYTES = 65_536
_ReaderT = TypeVar("_ReaderT", bound=Callable[..., Any])
# What messages call a file that states its kind and version.
DOCUMENT_DESCRIPTION = "an animtool file (YAML or JSON)"
_EXPORT_HINT = "export FBX, glTF or USD from {}, then use that file"


@dataclass(frozen=True, slots=True)
class Signature:
    """A file format and the first bytes of its files.

    Attributes:
        format_name: The format, with an article.
        pattern: Matches the first bytes, after a byte order mark and blanks.
        suffixes: Suffixes of such files, the most common first; empty if not readable.
        hint: Alternative, if the format is not readable.
    """

    format_name: str
    pattern: bytes
    suffixes: tuple[str, ...]
    hint: str = ""


def _signature(
    format_name: str, pattern: bytes, suffixes: str = "", hint: str = ""
) -> Signature:
    return Signature(format_name, pattern, tuple(suffixes.split()), hint)


_XML_START = rb"(?>(?:<\?.*?\?>|<!--.*?-->|<!doctype[^>]*>|\s)*)<"
_ZIP = rb"PK\x03\x04.{22}.{4}"
SIGNATURES = (
    _signature("a BVH file", rb"hierarchy\s", ".bvh"),
    _signature("a GLB file", rb"glTF[\x01\x02]\0\0\0", ".glb .vrm"),
    _signature("an FBX file", rb"Kaydara FBX Binary|; FBX \d", ".fbx"),
    _signature("a C3D file", rb"[\x02-\x0a]\x50.{6}", ".c3d"),
    _signature("a TRC file", rb"PathFileType[\t ,]", ".trc"),
    _signature(
        "an OpenSim motion file", rb"[^\0]{0,4000}\n[ \t]{0,20}endheader\b", ".mot .sto"
    ),
    _signature("a binary USD file", rb"PXR-USDC", ".usdc .usd"),
    _signature("a USD file of text", rb"#usda ", ".usda .usd"),
    _signature("a USD package", _ZIP + rb"[^\0]{1,200}?\.usd[ac]?", ".usdz"),
    _signature("an archive of arrays", _ZIP + rb"[^\0]{1,200}?\.npy", ".npz"),
    _signature("a URDF file", _XML_START + rb"robot[\s>]", ".urdf"),
    _signature("an MJCF file", _XML_START + rb"mujoco[\s>]", ".xml .mjcf"),
    _signature("a Live Link Face recording", rb"timecode,blendshapecount", ".csv"),
    _signature("a glTF file", rb'\{(?=.*"asset").*"(?:nodes|accessors)"', ".gltf .vrm"),
    _signature(
        DOCUMENT_DESCRIPTION,
        rb'[{"\s]*(?:' + "|".join(FILE_KINDS).encode() + rb')"?\s*:\s*"?animtool/',
        ".yaml .yml .json",
    ),
    _signature("a web page", _XML_START + rb"html[\s>]", "", "download the file again"),
    _signature(
        "a pointer of Git LFS",
        rb"version https://git-lfs\.",
        "",
        "fetch the file: git lfs pull",
    ),
    _signature(
        "a gzip file", rb"\x1f\x8b\x08", "", "decompress it: gunzip < FILE > COPY"
    ),
    _signature("an xz file", rb"\xfd7zXZ\0", "", "decompress it: unxz < FILE > COPY"),
    _signature(
        "a bzip2 file", rb"BZh[1-9]1AY&SY", "", "decompress it: bunzip2 < FILE > COPY"
    ),
    _signature("a Blender file", rb"BLENDER", "", _EXPORT_HINT.format("Blender")),
    _signature(
        "a Maya scene",
        rb"//Maya ASCII|FOR[48].{4,12}Maya",
        "",
        _EXPORT_HINT.format("Maya"),
    ),
    _signature(
        "an Alembic file",
        rb"Ogawa",
        "",
        "export FBX, glTF or USD of the skeleton from the tool that wrote it",
    ),
)


def signature_of(head: bytes) -> Signature | None:
    r"""Return the format that the first bytes of a file show; None if unknown.

    >>> signature_of(b"HIERARCHY\nROOT hips").suffixes
    ('.bvh',)
    """
    text = head.removeprefix(b"\xef\xbb\xbf").lstrip(b" \t\r\n")
    for signature in SIGNATURES:
        if re.match(signature.pattern, text, re.IGNORECASE | re.DOTALL):
            return signature
    return None


def format_mismatch(
    code: str, path: Path | str, expected_format: str, hint: str = ""
) -> Fault | None:
    """Return a fault if the first bytes of a file show a format other than expected.

    The expected format has an article: ``a GLB file``. ``hint`` is used if the suffix
    matches the detected format; without it, such a file has no fault.
    """
    path = Path(path)
    try:
        with open_input(path, None, is_recorded=False) as file:
            signature = signature_of(file.read(HEAD_BYTES))
    except FormatError:
        return None
    if signature is None or signature.format_name == expected_format:
        return None
    if path.suffix.lower() not in signature.suffixes:
        new_name = f"{path.stem}{signature.suffixes[0]}" if signature.suffixes else ""
        hint = signature.hint or f"rename it to {new_name}"
    elif "USD" in signature.format_name and "USD" in expected_format:
        return None
    message = f"is {signature.format_name}, not {expected_format}"
    if "USD" in signature.format_name and "USD" in expected_format:
        message = f"is {signature.format_name}, but is named {path.suffix}"
    return Fault(code, message, str(path), (), hint) if hint else None


def empty_error(code: str, path: Path | str) -> FormatError:
    """Return the error for an empty file."""
    hint = "export or copy it again"
    return FormatError(Fault(code, "the file is empty", str(path), hint=hint))


def expects_format(
    code: str, expected_format: str, hint: str = ""
) -> Callable[[_ReaderT], _ReaderT]:
    """Return a decorator for a reader that adds the detected format to its errors.

    The arguments are those of `format_mismatch`.
    """

    def decorate(read: _ReaderT) -> _ReaderT:
        @wraps(read)
        def read_checked(path: Path, *args: Any, **options: Any) -> Any:
            try:
                return read(path, *args, **options)
            except FormatError as error:
                state = FileState.of(Path(path))
                is_empty = state is not None and state.size == 0
                is_document = expected_format == DOCUMENT_DESCRIPTION
                if is_empty and not is_document and error.code != "IO001":
                    raise empty_error(error.code, path) from None
                fault = format_mismatch(code, path, expected_format, hint)
                if fault is None:
                    raise
                raise FormatError(fault) from None

        return cast(_ReaderT, read_checked)

    return decorate
