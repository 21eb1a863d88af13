"""Checks this project's CANopen engines against python-canopen, which nobody here wrote.

No CAN interface is needed: frames go through the pipes of the example `canopen_peer`.

    cargo build -p hil-tests --example canopen_peer
    pip install canopen
    python hil-tests/peers/python_canopen.py target/debug/examples/canopen_peer

Prints one line per check; the exit status is the number of failures.
"""

import logging
import queue
import random
import subprocess
import sys
import threading
import time

import can
import canopen
from canopen import objectdictionary as od

logging.disable(logging.CRITICAL)

PEER = sys.argv[1] if len(sys.argv) > 1 else "target/debug/examples/canopen_peer"
NODE = 5
NAME = b"a peer for other stacks"
randomness = random.Random(7)
failures = 0


class PipeBus(can.BusABC):
    """Frames as lines to and from the example; `is_lost(frame)` says which never arrive."""

    def __init__(self, arguments, is_lost=lambda message: False):
        super().__init__(channel="pipe")
        self.peer = subprocess.Popen(
            [PEER, *arguments], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
        )
        self.is_lost = is_lost
        self.lost = 0
        self.frames = queue.Queue()
        self.result = None
        self.reader = threading.Thread(target=self._read, daemon=True)
        self.reader.start()

    def _read(self):
        for line in self.peer.stdout:
            if line.startswith("="):
                self.result = line[1:].strip()
                continue
            identifier, data = line.strip().split("#")
            message = can.Message(
                arbitration_id=int(identifier, 16),
                data=bytes.fromhex(data),
                is_extended_id=False,
                timestamp=time.time(),
            )
            if self.is_lost(message):
                self.lost += 1
            else:
                self.frames.put(message)

    def send(self, msg, timeout=None):
        if self.is_lost(msg):
            self.lost += 1
            return
        text = f"R{msg.dlc}" if msg.is_remote_frame else bytes(msg.data).hex().upper()
        try:
            self.peer.stdin.write(f"{msg.arbitration_id:03X}#{text}\n")
            self.peer.stdin.flush()
        except (BrokenPipeError, ValueError):
            pass  # The peer has ended, as it does after a transfer.

    def _recv_internal(self, timeout):
        try:
            return self.frames.get(timeout=timeout), False
        except queue.Empty:
            return None, False

    def shutdown(self):
        super().shutdown()
        self.peer.kill()


def network(arguments, node=None, is_lost=lambda message: False):
    net = canopen.Network()
    net.bus = PipeBus(arguments, is_lost)
    if node is not None:
        net.add_node(node)
    net.notifier = can.Notifier(net.bus, net.listeners, 1)
    return net


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
    global failures
    start = time.time()
    try:
        run()
        print(f"ok    {name} ({time.time() - start:.2f} s)", flush=True)
    except Exception as error:  # Any failure of the foreign stack is a result.
        failures += 1
        print(f"FAIL  {name}: {type(error).__name__} {error}", flush=True)


def equal(got, wanted):
    assert got == wanted, f"{got!r:.80} is not {wanted!r:.80}"


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
    net = network(["device"], node)
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
        for _ in range(3):
            net.send_message(0x700 + NODE, [], remote=True)
            time.sleep(0.2)
        equal(answers, [0x7F, 0xFF, 0x7F])

    check("their client, expedited and segmented", short_values)
    for size in (8, 29, 889, 890, 5000):
        check(f"their client writes {size} bytes in blocks", lambda: round_trip(node, size, True, False))
        check(f"their client reads {size} bytes in blocks", lambda: round_trip(node, size, False, True))
    check("their client, 100000 bytes in blocks both ways", lambda: round_trip(node, 100_000, True, True))
    check("their client is refused", abort)
    check("their master stores, resets, hears the heartbeat", store)
    check("their master guards", guarding)
    net.disconnect()


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
        net = network(["device"], node, is_lost)
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


def result(net):
    bus = net.bus
    bus.peer.wait(20)
    bus.reader.join(2)
    net.disconnect()
    return bus.result


def our_client():
    def read(data, options):
        node = canopen.LocalNode(NODE, dictionary())
        node.set_data(0x2001, 0, data)
        net = network(["read", "2001", "0", *options], node)
        equal(result(net), data.hex().upper())

    def write(data, options):
        node = canopen.LocalNode(NODE, dictionary())
        net = network(["write", "2001", "0", data.hex(), *options], node)
        equal(result(net), "ok")
        equal(bytes(node.get_data(0x2001, 0)), data)

    # Their server has no blocks: reads are switched to segments, writes refused and begun anew in segments.
    for size in (4, 29, 5000):
        data = randomness.randbytes(size)
        for options in ([], ["block"]):
            how = " asking for blocks" if options else ""
            check(f"our client reads {size} bytes{how}", lambda: read(data, options))
            check(f"our client writes {size} bytes{how}", lambda: write(data, options))


def our_lss_slave():
    net = network(["bare-device"])
    # Silence is an answer in a scan: too short a time makes it wrong.
    net.lss.RESPONSE_TIMEOUT = 0.2

    def commission():
        is_found, identity = net.lss.fast_scan()
        assert is_found, "nobody found"
        equal(list(identity), [0x01020304, 0x80000001, 1, 0xFFFFFFFE])
        net.lss.configure_node_id(9)
        net.lss.configure_bit_timing(2)
        net.lss.store_configuration()
        equal(net.lss.inquire_lss_address(0x5A), 0x01020304)
        node = net.add_node(9, dictionary())
        net.lss.send_switch_state_global(net.lss.WAITING_STATE)
        node.nmt.wait_for_bootup(3)
        equal(node.sdo.upload(0x1008, 0), NAME)

    check("their LSS master finds, configures and starts a device", commission)
    net.disconnect()


our_server()
our_server_on_a_lossy_line()
our_client()
our_lss_slave()
sys.exit(min(failures, 255))
