"""Prints, as JSON, what the XML reader of Python finds in device descriptions (ESI)."""

import json
import sys
from xml.etree import ElementTree


def number(text):
    text = (text or "0").strip()
    return int(text[2:], 16) if text.lower().startswith("#x") else int(text)


def pdo(element):
    entries = [
        [number(entry.findtext("Index")), number(entry.findtext("SubIndex")), number(entry.findtext("BitLen"))]
        for entry in element.findall("Entry")
    ]
    return [number(element.findtext("Index")), entries]


def device(element):
    kind = element.find("Type")
    managers = element.findall("Sm")
    return {
        "type": (kind.text or "").strip(),
        "product": number(kind.get("ProductCode")),
        "revision": number(kind.get("RevisionNo")),
        "managers": [[number(sm.get("StartAddress")), number(sm.get("ControlByte")), (sm.text or "").strip()] for sm in managers],
        "outputs": [pdo(one) for one in element.findall("RxPdo")],
        "inputs": [pdo(one) for one in element.findall("TxPdo")],
        "configuration": (element.findtext("Eeprom/ConfigData") or "").strip(),
    }


def description(path):
    root = ElementTree.parse(path).getroot()
    devices = root.findall("Descriptions/Devices/Device")
    return {"root": root.tag, "vendor": number(root.findtext("Vendor/Id")), "devices": [device(one) for one in devices]}


print(json.dumps([description(path) for path in sys.argv[1:]]))
