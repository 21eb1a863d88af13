"""SDO client of this project against that of python-canopen, side by side: same interface, same server, same boot.

    cargo build -p hil-tests --example canopen_peer
    hil-tests/vcan $(hil-tests/peers/install) hil-tests/peers/sdo_speed.py target/debug

The server is held fixed, first ours and then theirs, and in turns each client reads a 4-byte object again and again, then a
long one in segments. Of several rounds the median counts. Prints one line per server and kind, and ends with 1 if our
client is not at least 4 times as fast in each. On one processor the server's time is part of every transfer: the share of it
in ours says what ratio a client had that took no time at all. It measures; it is no test: times on a busy machine say little.
"""

import os
import statistics
import subprocess
import sys
import time

import canopen

import drives

PEER = f"{sys.argv[1] if len(sys.argv) > 1 else 'target/debug'}/examples/canopen_peer"
INTERFACE = os.environ.get("YIELDWALL_CAN", "vcan0")
NODE = 5
READS, BYTES, TRANSFERS, ROUNDS = 1000, 7000, 5, 5
LONG = bytes(range(250)) * (BYTES // 250)
GOAL = 4


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


def their_client(node):
    """Reads per second, and bytes per second in segments."""
    begin = time.perf_counter()
    for _ in range(READS):
        assert len(node.sdo.upload(0x2000, 0)) == 4
    short = READS / (time.perf_counter() - begin)
    begin = time.perf_counter()
    for _ in range(TRANSFERS):
        assert node.sdo.upload(0x2001, 0) == LONG
    return short, TRANSFERS * BYTES / (time.perf_counter() - begin)


def our_client():
    command = [PEER, "speed", str(READS), str(BYTES), str(TRANSFERS)]
    done = subprocess.run(command, check=True, capture_output=True, text=True, timeout=300)
    short, long = done.stdout.removeprefix("=").split()
    return float(short), float(long)


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
    node.set_data(0x2001, 0, LONG)
    network.add_node(node)
    print("= ready", flush=True)
    while True:
        time.sleep(60)


def compare(server, command):
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    network = drives.connect(INTERFACE)
    try:
        assert process.stdout.readline().strip() == "= ready"
        node = canopen.RemoteNode(NODE, dictionary())
        network.add_node(node)
        node.sdo.RESPONSE_TIMEOUT = 5
        if server == "ours":
            node.sdo.download(0x2001, 0, LONG)
        rounds, served_s, took_s = [], 0, 0
        for _ in range(ROUNDS):
            theirs = their_client(node)
            # Whoever only listens costs time too.
            network.disconnect()
            served_s -= processor_s(process)
            took_s -= time.perf_counter()
            ours = our_client()
            served_s += processor_s(process)
            took_s += time.perf_counter()
            network.connect(interface="socketcan", channel=INTERFACE)
            rounds.append((ours, theirs))
        worst = float("inf")
        for kind, unit in ((0, "reads of 4 bytes/s"), (1, "bytes/s in segments")):
            ours, theirs = (statistics.median(line[who][kind] for line in rounds) for who in (0, 1))
            worst = min(worst, ours / theirs)
            print(
                f"server {server:6}  {unit:19}  our client {ours:8.0f}  python-canopen {theirs:8.0f}  ratio {ours / theirs:5.1f}",
                flush=True,
            )
        share = served_s / took_s
        short = [statistics.median(line[who][0] for line in rounds) for who in (0, 1)]
        print(f"server {server:6}  has {100 * share:.0f} % of our client's time: no client gets beyond {short[0] / short[1] / share:.1f}")
        return worst
    finally:
        network.disconnect()
        process.kill()
        process.wait()


def main():
    if sys.argv[-1] == "serve":
        serve()
    worst = min(compare("ours", [PEER, "device"]), compare("theirs", [sys.executable, __file__, "serve"]))
    print(f"our client is at least {worst:.1f} times as fast (goal {GOAL})")
    return worst < GOAL


if __name__ == "__main__":
    sys.exit(main())
