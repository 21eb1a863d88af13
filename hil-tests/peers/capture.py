"""Writes down what python-canopen and this project say to each other, in the log format of candump.

    hil-tests/vcan $(hil-tests/peers/install) hil-tests/peers/capture.py target/debug

The logs in hil-tests/peers/captured are the golden ones of the test `captured`, which needs neither Python nor an interface.
Run this again only when what is said shall change, and read the difference.
"""

import os
import re
import signal
import subprocess
import sys
import threading
import time

import canopen

import drives
import sdo_speed

PEER = sdo_speed.PEER
INTERFACE = sdo_speed.INTERFACE
FOLDER = os.path.join(os.path.dirname(os.path.abspath(__file__)), "captured")
LONG = bytes(place * 37 % 256 for place in range(100))


def with_device(kind, talk):
    peer = subprocess.Popen([PEER, kind], stdout=subprocess.PIPE, text=True)
    network = drives.connect(INTERFACE)
    try:
        assert peer.stdout.readline().strip() == "= ready"
        talk(network)
    finally:
        network.disconnect()
        peer.kill()
        peer.wait()


def their_client(network):
    """Expedited, segmented and block transfers both ways, refusals, NMT and guarding."""
    node = canopen.RemoteNode(5, sdo_speed.dictionary())
    network.add_node(node)
    node.sdo.RESPONSE_TIMEOUT = 5
    node.sdo.download(0x2000, 0, bytes.fromhex("44332211"))
    node.sdo.upload(0x2000, 0)
    node.sdo.upload(0x1008, 0)
    for is_block in (False, True):
        with node.sdo.open(0x2001, 0, "wb", size=len(LONG), block_transfer=is_block) as stream:
            stream.write(LONG)
        with node.sdo.open(0x2001, 0, "rb", block_transfer=is_block) as stream:
            assert stream.read() == LONG
    for index, sub in ((0x5FFF, 0), (0x1018, 9)):
        try:
            node.sdo.upload(index, sub)
        except canopen.SdoAbortedError:
            continue
        raise AssertionError("not refused")
    for command in (0x01, 0x02, 0x80):
        node.nmt.send_command(command)
        for _ in range(2):
            network.send_message(0x705, [], remote=True)
            time.sleep(0.05)
    node.nmt.send_command(0x81)
    time.sleep(0.1)


def their_lss_master(network):
    """Fastscan, node id, bit timing, storing, identity."""
    network.lss.RESPONSE_TIMEOUT = 0.1
    is_found, _identity = network.lss.fast_scan()
    assert is_found, "nobody found"
    network.lss.configure_node_id(9)
    network.lss.configure_bit_timing(2)
    network.lss.store_configuration()
    for part in (0x5A, 0x5B, 0x5C, 0x5D):
        network.lss.inquire_lss_address(part)
    network.lss.send_switch_state_global(network.lss.WAITING_STATE)
    time.sleep(0.1)


def our_client():
    """Reads and writes of our client, which asks their server for blocks in vain."""
    network = drives.connect(INTERFACE)
    node = canopen.LocalNode(5, sdo_speed.dictionary())
    node.set_data(0x2000, 0, bytes.fromhex("44332211"))
    network.add_node(node)
    try:
        for arguments in (
            ["read", "2000", "0"],
            ["write", "2001", "0", LONG.hex()],
            ["read", "2001", "0"],
            ["write", "2001", "0", LONG[:50].hex(), "block"],
            ["read", "2001", "0", "block"],
            ["write", "2000", "0", "01"],
            ["read", "5fff", "0"],
        ):
            subprocess.run([PEER, *arguments], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, timeout=30)
    finally:
        network.disconnect()


def capture(name, talk):
    dump = subprocess.Popen(["candump", "-L", INTERFACE], stdout=subprocess.PIPE, text=True)
    lines = []
    reader = threading.Thread(target=lambda: lines.extend(dump.stdout))
    reader.start()
    time.sleep(0.5)
    talk()
    time.sleep(0.5)
    dump.send_signal(signal.SIGINT)
    reader.join()
    dump.wait()
    begin = None
    with open(os.path.join(FOLDER, f"{name}.log"), "w", encoding="ascii") as log:
        for line in lines:
            stamp, rest = re.match(r"\(([0-9.]+)\) (.*)", line).groups()
            begin = begin if begin is not None else float(stamp)
            log.write(f"({float(stamp) - begin:017.6f}) {rest}\n")
    print(f"{name}: {len(lines)} frames")


os.makedirs(FOLDER, exist_ok=True)
capture("their-client", lambda: with_device("device", their_client))
capture("their-lss-master", lambda: with_device("bare-device", their_lss_master))
capture("our-client", our_client)
