"""Prints, as JSON, the entries that python-canopen reads from data sheets and configuration files."""

import json
import sys

from canopen.objectdictionary import ODVariable, import_od

NODE = 5


def entry(variable):
    keep = lambda value: value.hex() if isinstance(value, bytes) else value
    return {
        "name": variable.name,
        "data_type": variable.data_type,
        "access": variable.access_type,
        "default": keep(variable.default),
        "low": variable.min,
        "high": variable.max,
        "value": keep(variable.value),
    }


def entries(path):
    found = {}
    for thing in import_od(path, node_id=NODE).values():
        for variable in [thing] if isinstance(thing, ODVariable) else thing.values():
            found[f"{variable.index:04X}:{variable.subindex:02X}"] = entry(variable)
    return found


print(json.dumps([entries(path) for path in sys.argv[1:]]))
