"""Checks this project's CANopen engines and drives against python-canopen, which nobody here wrote, on a CAN interface.

    cargo build --workspace --bins --examples
    hil-tests/vcan $(hil-tests/peers/install) hil-tests/peers/python_canopen.py target/debug [few]

The argument is the folder with the built programs; with `few` the two shortest checks of its masters run alone. YIELDWALL_CAN names the interface, vcan0 otherwise. Prints one line per
check and a closing line; the exit status is the number of failures.
"""

import logging
import os
import random
import subprocess
import sys
import threading
import time

import can
import canopen
from can.interfaces.socketcan import SocketcanBus
from canopen import objectdictionary as od

import commissioned
import drives

logging.disable(logging.CRITICAL)

PROGRAMS = sys.argv[1] if len(sys.argv) > 1 else "target/debug"
PEER = f"{PROGRAMS}/examples/canopen_peer"
INTERFACE = os.environ.get("YIELDWALL_CAN", "vcan0")
NODE = 5
NAME = b"a peer for other stacks"
randomness = random.Random(7)
begun = time.time()
failures = []
passed = 0


class LossyBus(SocketcanBus):
    """Loses the frames of both ways for which `is_lost(frame)`."""

    def __init__(self, is_lost):
        super().__init__(channel=INTERFACE)
        self.is_lost = is_lost
        self.lost = 0

    def send(self, msg, timeout=None):
        if self.is_lost(msg):
            self.lost += 1
        else:
            super().send(msg, timeout)

    def _recv_internal(self, timeout):
        message, is_filtered = super()._recv_internal(timeout)
        if message is not None and self.is_lost(message):
            self.lost += 1
            return None, is_filtered
        return message, is_filtered


class Peer:
    """The example `canopen_peer`, and what it says."""

    def __init__(self, arguments):
        self.process = subprocess.Popen([PEER, *arguments], stdout=subprocess.PIPE, text=True)

    def says(self):
        return self.process.stdout.readline().removeprefix("=").strip()

    def end(self):
        self.process.kill()
        self.process.wait()


def network(node=None, is_lost=lambda message: False):
    net = canopen.Network()
    net.bus = LossyBus(is_lost)
    if node is not None:
        net.add_node(node)
    net.notifier = can.Notifier(net.bus, net.listeners, 0.1)
    return net


def our_device(arguments=("device",)):
    peer = Peer(arguments)
    assert peer.says() == "ready"
    return peer


def dictionary():
    objects = od.ObjectDictionary()
    for name, index, data_type in [
        ("name", 0x1008, od.VISIBLE_STRING),
        ("number", 0x2000, od.UNSIGNED32),
        ("domain", 0x2001, od.DOMAIN),
    ]:
        variable = od.ODVariable(name, index, 0)
        variable.data_type = data_type
        variable.access_type = "rw"
        objects.add_object(variable)
    return objects


def check(name, run):
    global passed
    start = time.time()
    try:
        run()
        passed += 1
        print(f"ok    {name} ({time.time() - start:.2f} s)", flush=True)
    except Exception as error:  # Any failure of the foreign stack is a result.
        failures.append(name)
        print(f"FAIL  {name}: {type(error).__name__} {error}", flush=True)


def equal(got, wanted):
    assert got == wanted, f"{got!r:.80} is not {wanted!r:.80}"


def wait_for(is_so, longest_s=5):
    end = time.monotonic() + longest_s
    while not is_so() and time.monotonic() < end:
        time.sleep(0.005)


def round_trip(node, size, writes_blocks, reads_blocks):
    data = randomness.randbytes(size)
    buffering = 127 * 7 if writes_blocks else 1024
    with node.sdo.open(
        0x2001, 0, "wb", size=size, block_transfer=writes_blocks, buffering=buffering
    ) as stream:
        stream.write(data)
    with node.sdo.open(0x2001, 0, "rb", block_transfer=reads_blocks) as stream:
        equal(stream.read(), data)


def our_server():
    node = canopen.RemoteNode(NODE, dictionary())
    peer = our_device()
    net = network(node)
    node.sdo.RESPONSE_TIMEOUT = 2

    def short_values():
        node.sdo.download(0x2000, 0, bytes.fromhex("44332211"))
        equal(node.sdo.upload(0x2000, 0), bytes.fromhex("44332211"))
        equal(node.sdo.upload(0x1008, 0), NAME)

    def abort():
        try:
            node.sdo.upload(0x5FFF, 0)
        except canopen.SdoAbortedError as error:
            return equal(error.code, 0x06020000)
        raise AssertionError("not refused")

    def store():
        node.sdo.download(0x1017, 0, (200).to_bytes(2, "little"))
        node.sdo.download(0x1010, 1, b"save")
        boot_up = threading.Event()
        net.subscribe(0x700 + NODE, lambda _id, data, _time: data[0] == 0 and boot_up.set())
        node.nmt.send_command(0x81)
        assert boot_up.wait(3), "no boot-up message"
        equal(node.sdo.upload(0x1017, 0), (200).to_bytes(2, "little"))
        node.nmt.wait_for_heartbeat(3)
        equal(node.nmt.state, "PRE-OPERATIONAL")
        node.sdo.download(0x1017, 0, bytes(2))

    def guarding():
        answers = []
        net.subscribe(0x700 + NODE, lambda _id, data, _time: answers.append(data[0]))
        for asked in (1, 2, 3):
            net.send_message(0x700 + NODE, [], remote=True)
            wait_for(lambda: len(answers) == asked)
        equal(answers, [0x7F, 0xFF, 0x7F])

    check("their client, expedited and segmented", short_values)
    for size in (8, 29, 889, 890, 5000):
        check(f"their client writes {size} bytes in blocks", lambda: round_trip(node, size, True, False))
        check(f"their client reads {size} bytes in blocks", lambda: round_trip(node, size, False, True))
    check("their client, 20000 bytes in blocks both ways", lambda: round_trip(node, 20_000, True, True))
    check("their client is refused", abort)
    check("their master stores, resets, hears the heartbeat", store)
    check("their master guards", guarding)
    net.disconnect()
    peer.end()


def our_server_on_a_lossy_line():
    """Two segments are lost, neither the last of a block nor sent again: their client recovers nothing else."""
    data = randomness.randbytes(5000)
    for identifier in (0x580 + NODE, 0x600 + NODE):
        count = 0
        is_active = False

        def is_lost(message):
            nonlocal count
            is_segment = is_active and message.arbitration_id == identifier and 0 < message.data[0] < 0x60
            count += is_segment
            return is_segment and count in (50, 400)

        node = canopen.RemoteNode(NODE, dictionary())
        peer = our_device()
        net = network(node, is_lost)
        node.sdo.RESPONSE_TIMEOUT = 2

        def read():
            nonlocal is_active
            node.sdo.download(0x2001, 0, data)
            is_active = True
            with node.sdo.open(0x2001, 0, "rb", block_transfer=True) as stream:
                equal(stream.read(), data)
            equal(net.bus.lost, 2)

        def write():
            nonlocal is_active
            is_active = True
            # Without a buffer: what it sends again it reads from the buffer, which has other data by then.
            with node.sdo.open(0x2001, 0, "wb", size=len(data), block_transfer=True, buffering=0) as stream:
                while stream.tell() < len(data):
                    stream.write(data[stream.tell() : stream.tell() + 7])
            is_active = False
            equal(node.sdo.upload(0x2001, 0), data)
            equal(net.bus.lost, 2)

        is_read = identifier == 0x580 + NODE
        check(f"their client {'reads' if is_read else 'writes'} in blocks, 2 segments lost", read if is_read else write)
        net.disconnect()
        peer.end()


def result(net, arguments):
    peer = Peer(arguments)
    said = peer.says()
    peer.process.wait(20)
    net.disconnect()
    return said


def our_client():
    def read(data, options):
        node = canopen.LocalNode(NODE, dictionary())
        node.set_data(0x2001, 0, data)
        equal(result(network(node), ["read", "2001", "0", *options]), data.hex().upper())

    def write(data, options):
        node = canopen.LocalNode(NODE, dictionary())
        equal(result(network(node), ["write", "2001", "0", data.hex(), *options]), "ok")
        equal(bytes(node.get_data(0x2001, 0)), data)

    # Their server has no blocks: reads are switched to segments, writes refused and begun anew in segments.
    for size in (4, 29, 5000):
        data = randomness.randbytes(size)
        for options in ([], ["block"]):
            how = " asking for blocks" if options else ""
            check(f"our client reads {size} bytes{how}", lambda: read(data, options))
            check(f"our client writes {size} bytes{how}", lambda: write(data, options))


def our_lss_slave():
    peer = our_device(["bare-device"])
    net = network()
    # Silence is an answer in a scan: too short a time makes it wrong.
    net.lss.RESPONSE_TIMEOUT = 0.5

    def commission():
        is_found, identity = net.lss.fast_scan()
        assert is_found, "nobody found"
        equal(list(identity), [0x01020304, 0x80000001, 1, 0xFFFFFFFE])
        net.lss.configure_node_id(9)
        net.lss.configure_bit_timing(2)
        net.lss.store_configuration()
        equal(net.lss.inquire_lss_address(0x5A), 0x01020304)
        node = net.add_node(9, dictionary())
        boot_up = threading.Event()
        net.subscribe(0x709, lambda _id, data, _time: data[0] == 0 and boot_up.set())
        net.lss.send_switch_state_global(net.lss.WAITING_STATE)
        assert boot_up.wait(3), "no boot-up message"
        equal(node.sdo.upload(0x1008, 0), NAME)

    check("their LSS master finds, configures and starts a device", commission)
    net.disconnect()
    peer.end()


FEW = sys.argv[2:] == ["few"]
if not FEW:
    our_server()
    our_server_on_a_lossy_line()
    our_client()
our_lss_slave()
check("their CiA 402 master enables, moves, loses and resets our drive", lambda: drives.ours(PROGRAMS, INTERFACE))
if not FEW:
    check("our master boots, enables and runs their drives and sensor", lambda: drives.theirs(PROGRAMS, INTERFACE))
    check("their drives with a data sheet are adopted and run by what was found", lambda: drives.adopted(PROGRAMS, INTERFACE))
    check("their drives are commissioned by the wall clock and jogged", lambda: commissioned.commissioned(PROGRAMS, INTERFACE))
print(
    f"\ntest result: {'FAILED' if failures else 'ok'}. {passed} passed; {len(failures)} failed; 0 ignored; 0 measured; "
    f"0 filtered out; finished in {time.time() - begun:.2f}s"
)
sys.exit(min(len(failures), 255))
