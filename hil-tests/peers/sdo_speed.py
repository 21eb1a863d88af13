"""SDO clients side by side, in one boot: this project's, that of an earlier build of it, and python-canopen's.

    cargo build -p hil-tests --example canopen_peer
    hil-tests/vcan $(hil-tests/peers/install) hil-tests/peers/sdo_speed.py target/debug [BEFORE]

BEFORE is the same folder of an earlier build, whose client runs on its own server. One of commit a536e69 is made so:

    git worktree add --detach target/before a536e69
    cp hil-tests/examples/canopen_peer.rs target/before/hil-tests/examples/
    (cd target/before && cargo build -p hil-tests --example canopen_peer)

and BEFORE is then target/before/target/debug. In each of several rounds each client in turn reads a 4-byte object again and
again, then a long one in segments, and from our servers a longer one both ways in blocks, which python-canopen's server does
not have. The median of the rounds counts. No process data run.

Ends with 1 if a goal is missed: against python-canopen 4 times in reads and segments; against the earlier build 4 times in
blocks, 1.25 times in segments, and as fast in reads. On one processor the server's time is part of every transfer: the share
of it in ours says what ratio a client had that took no time at all. It measures; it is no test: times on a busy machine say
little.
"""

import contextlib
import os
import statistics
import subprocess
import sys
import time

import canopen

import drives

FOLDER, BEFORE = (sys.argv[1:3] + [None, None])[:2]
FOLDER = FOLDER or "target/debug"
INTERFACE = os.environ.get("YIELDWALL_CAN", "vcan0")
NODE = 5
READS, BYTES, TRANSFERS, ROUNDS = 1000, 7000, 5, 7
BLOCK = 40_000
KINDS = ("reads of 4 bytes/s", "bytes/s in segments", "bytes/s read in blocks", "bytes/s written in blocks")
AGAINST_PYTHON = (4, 4, 0, 0)
AGAINST_BEFORE = (1, 1.25, 4, 4)


def data(length):
    return (bytes(range(250)) * (length // 250 + 1))[:length]


def peer(folder):
    return f"{folder}/examples/canopen_peer"


def dictionary():
    objects = canopen.ObjectDictionary()
    for name, index, data_type in (
        ("number", 0x2000, canopen.objectdictionary.UNSIGNED32),
        ("domain", 0x2001, canopen.objectdictionary.DOMAIN),
    ):
        variable = canopen.objectdictionary.ODVariable(name, index, 0)
        variable.data_type, variable.access_type = data_type, "rw"
        objects.add_object(variable)
    return objects


def per_second(count, act):
    begin = time.perf_counter()
    act()
    return count / (time.perf_counter() - begin)


def their_client(block):
    """A rate of each kind."""
    network = drives.connect(INTERFACE)
    try:
        node = canopen.RemoteNode(NODE, dictionary())
        network.add_node(node)
        node.sdo.RESPONSE_TIMEOUT = 5

        def read_short():
            for _ in range(READS):
                assert len(node.sdo.upload(0x2000, 0)) == 4

        def read_long():
            for _ in range(TRANSFERS):
                assert node.sdo.upload(0x2001, 0) == data(BYTES)

        def write_blocks():
            with node.sdo.open(0x2001, 0, "wb", size=block, block_transfer=True, buffering=127 * 7) as stream:
                stream.write(data(block))

        def read_blocks():
            with node.sdo.open(0x2001, 0, "rb", block_transfer=True) as stream:
                assert stream.read() == data(block)

        short = per_second(READS, read_short)
        node.sdo.download(0x2001, 0, data(BYTES))
        rates = [short, per_second(TRANSFERS * BYTES, read_long)]
        if block:
            written = per_second(block, write_blocks)
            rates += [per_second(block, read_blocks), written]
        return rates
    finally:
        network.disconnect()


def our_client(folder, block):
    command = [peer(folder), "speed", str(READS), str(BYTES), str(TRANSFERS), str(block)]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, timeout=300)
    return [float(word) for word in done.stdout.removeprefix("=").split()]


def processor_s(process):
    """Time that a process has had a processor."""
    with open(f"/proc/{process.pid}/stat", encoding="ascii") as file:
        fields = file.read().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def serve():
    """Their server, in a process of its own."""
    network = drives.connect(INTERFACE)
    node = canopen.LocalNode(NODE, dictionary())
    node.set_data(0x2000, 0, bytes(4))
    node.set_data(0x2001, 0, data(BYTES))
    network.add_node(node)
    print("= ready", flush=True)
    while True:
        time.sleep(60)


@contextlib.contextmanager
def server(command):
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout.readline().strip() == "= ready"
        yield process
    finally:
        process.kill()
        process.wait()


def main():
    if sys.argv[-1] == "serve":
        serve()
    # By server and client, a list of rates for each round.
    rounds, share = {}, {}

    def note(which, rates):
        rounds.setdefault(which, []).append(rates)

    def both(name, command, block):
        with server(command) as process:
            served_s, begin = processor_s(process), time.perf_counter()
            note((name, "ours"), our_client(FOLDER, block))
            took = share.setdefault(name, [0, 0])
            took[0] += processor_s(process) - served_s
            took[1] += time.perf_counter() - begin
            note((name, "python-canopen"), their_client(block))

    def before():
        with server([peer(BEFORE), "device"]):
            note(("before", "before"), our_client(BEFORE, BLOCK))

    for number in range(ROUNDS):
        turns = [lambda: both("ours", [peer(FOLDER), "device"], BLOCK)]
        turns += [before] if BEFORE else []
        # Who comes first in a round has an advantage on some machines.
        for turn in reversed(turns) if number % 2 else turns:
            turn()
        both("theirs", [sys.executable, __file__, "serve"], 0)

    rates = {which: [statistics.median(kind) for kind in zip(*lines)] for which, lines in rounds.items()}
    is_met = True
    for name in ("ours", "theirs"):
        for kind, label in enumerate(KINDS[: len(rates[name, "ours"])]):
            ours = rates[name, "ours"][kind]
            line = f"server {name:6}  {label:25}  our client {ours:8.0f}"
            others = [("python-canopen", (name, "python-canopen"), AGAINST_PYTHON)]
            if BEFORE and name == "ours":
                others.append(("before", ("before", "before"), AGAINST_BEFORE))
            for label, which, goals in others:
                ratio, goal = ours / rates[which][kind], goals[kind]
                verdict = "" if not goal else " met" if ratio >= goal else f" MISSED, goal {goal}"
                is_met &= ratio >= goal
                line += f"  {label} {rates[which][kind]:8.0f} ratio {ratio:5.2f}{verdict}"
            print(line, flush=True)
        served_s, took_s = share[name]
        print(f"server {name:6}  has the processor for {100 * served_s / took_s:.0f} % of our client's time")
    return not is_met


if __name__ == "__main__":
    sys.exit(main())
