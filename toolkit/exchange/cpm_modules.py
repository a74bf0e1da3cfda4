"""ASN.1 modules of the Collective Perception Message, which come from a folder of the user's.

coview does not contain ETSI's texts. The modules come from TS 103 324 V2.1.1 and from the common
data dictionary that it imports (TS 102 894-2), one or several in a file."""

import re
from functools import lru_cache
from pathlib import Path
from typing import Any

from toolkit.datasets.record_values import name_damage
from toolkit.runtime.reading import read_plain

CPM_MODULES = (
    "CPM-PDU-Descriptions",
    "CPM-OriginatingStationContainers",
    "CPM-SensorInformationContainer",
    "CPM-PerceptionRegionContainer",
    "CPM-PerceivedObjectContainer",
    "ETSI-ITS-CDD",
)
ASN1_ENDINGS = (".asn", ".asn1")
# NAME {object identifier} DEFINITIONS
_MODULE_HEADER = re.compile(r"^\s*([A-Z][\w-]*)\s*(?:\{[^{}]*\}\s*)?DEFINITIONS\b", re.MULTILINE)


def find_cpm_modules(folder: Path) -> list[Path]:
    """List the files of a folder and those below that hold the modules of the message.

    Files without such a module are left out. Raises OSError for a missing folder, ValueError for a
    missing module and one that is there twice."""
    if not folder.is_dir():
        raise NotADirectoryError(f"{folder} is no folder: name the folder of the ASN.1 modules")
    path_by_module: dict[str, Path] = {}
    paths = sorted(path for path in folder.rglob("*") if path.suffix.lower() in ASN1_ENDINGS)
    for path in paths:
        for module in _MODULE_HEADER.findall(_read_module(path)):
            if module not in CPM_MODULES:
                continue
            if module in path_by_module:
                raise ValueError(
                    f"{folder} has the ASN.1 module {module} in {path_by_module[module].name} and "
                    f"in {path.name}: leave one out"
                )
            path_by_module[module] = path
    missing_modules = [module for module in CPM_MODULES if module not in path_by_module]
    if missing_modules:
        raise ValueError(
            f"{folder} lacks the ASN.1 module {missing_modules[0]}: put files of "
            f"{', '.join(CPM_MODULES)} there, which end in {ASN1_ENDINGS[0]}"
        )
    return list(dict.fromkeys(path_by_module.values()))


@lru_cache(maxsize=1)  # compiling takes seconds, and every file of a running centre needs it
def compile_cpm_modules(folder: Path) -> Any:
    """Return the message's asn1tools specification, in unaligned packed encoding (UPER).

    Raises OSError and ValueError for modules that are missing or do not compile."""
    import asn1tools

    texts = [_read_module(path) for path in find_cpm_modules(folder)]
    damage = (asn1tools.ParseError, asn1tools.CompileError, LookupError, TypeError)
    with name_damage(folder, "folder of ASN.1 modules", damage):
        modules = asn1tools.parse_string("\n".join(texts))
        join_unions(modules)
        return asn1tools.compile_dict(modules, "uper")


def join_unions(modules: dict[str, Any]) -> None:
    """Replace each union of whole numbers by the range from its lowest to its highest, in place.

    The encoding needs that range. asn1tools 0.169 takes a union's first part for the whole, so that
    a passenger car would have no bits and spoil the number before it. modules: parsed modules."""
    numbers_by_type: dict[str, dict[str, int]] = {}
    for module in modules.values():
        for name, described in module["types"].items():
            numbers_by_type[name] = described.get("named-numbers", {})
    for described in _list_restricted(modules):
        numbers = numbers_by_type.get(described["type"], {})
        bounds: list[Any] = []
        for part in described["restricted-to"]:
            bounds += part if isinstance(part, tuple) else (part,)
        values = [numbers.get(bound, bound) for bound in bounds]
        if all(isinstance(value, int) for value in values):
            described["restricted-to"] = [(min(values), max(values))]


def _list_restricted(node: Any) -> list[dict[str, Any]]:
    """List the descriptions of restricted types in a parsed module, at any depth."""
    described = []
    if isinstance(node, dict) and "restricted-to" in node:
        described.append(node)
    children = node.values() if isinstance(node, dict) else node
    for child in children:
        if isinstance(child, dict | list):
            described += _list_restricted(child)
    return described


def _read_module(path: Path) -> str:
    """Return the text of a file; comments may have bytes that are not UTF-8."""
    return read_plain(path).decode("utf-8", errors="replace")
