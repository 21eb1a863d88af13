"""Checks the simulated EtherCAT segment against pysoem (SOEM), a master that nobody here wrote, over two ends of an Ethernet cable.

    cargo build
    hil-tests/veth $(hil-tests/peers/install_pysoem) hil-tests/peers/pysoem_master.py [--capture FILE.pcap] \\
        target/debug/yieldwall sim config/paper-ethercat.yaml --bus main=veth1

The command after the script serves the segment of two drives and a sensor on veth1; pysoem is on veth0. Prints one line per check and a closing line;
the exit status is the number of failures. Nothing is said of times: waits are long, and counts, states and contents are judged.
"""

import struct
import subprocess
import sys
import threading
import time

import pysoem

ARGUMENTS = sys.argv[1:]
CAPTURE = None
if "--capture" in ARGUMENTS:
    at = ARGUMENTS.index("--capture")
    CAPTURE = ARGUMENTS[at + 1]
    del ARGUMENTS[at : at + 2]
INTERFACE = "veth0"
PERIOD_S = 0.002
SYNC0_NS = 1_000_000
# For a computer that has other things to do, in us.
PATIENCE_US = 500_000
FAILED = 0x0008
OPERATION_ENABLED, SWITCH_ON_DISABLED = 0x0027, 0x0040
CYCLIC_POSITION = 8
begun = time.time()
failures = []
passed = 0


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
    assert got == wanted, f"{got!r:.200} is not {wanted!r:.200}"


def wait_for(is_so, longest_s=10):
    end = time.monotonic() + longest_s
    while not is_so():
        assert time.monotonic() < end, "it does not come"
        time.sleep(0.005)


class Exchange:
    """Process data, exchanged by a thread; a stop is sudden, as that of a process that is killed."""

    def __init__(self, master):
        self.master = master
        self.is_on = False
        self.before = lambda: None
        self.counters = []

    def start(self):
        self.is_on = True
        self.thread = threading.Thread(target=self.run)
        self.thread.start()

    def run(self):
        while self.is_on:
            self.before()
            self.master.send_processdata()
            self.counters.append(self.master.receive_processdata(PATIENCE_US))
            time.sleep(PERIOD_S)

    def stop(self):
        self.is_on = False
        self.thread.join()


def mapping(slave, assignment):
    """Where each object is in the process data, as the device says it: (index, sub) to (byte, bytes)."""
    places, at = {}, 0
    for number in range(1, slave.sdo_read(assignment, 0)[0] + 1):
        (pdo,) = struct.unpack("<H", slave.sdo_read(assignment, number))
        for entry in range(1, slave.sdo_read(pdo, 0)[0] + 1):
            (packed,) = struct.unpack("<I", slave.sdo_read(pdo, entry))
            index, sub, bits = packed >> 16, packed >> 8 & 0xFF, packed & 0xFF
            assert bits % 8 == 0
            places[(index, sub)] = (at, bits // 8)
            at += bits // 8
    return places, at


class Drive:
    """Words of a drive in the process data."""

    def __init__(self, slave):
        self.slave = slave
        self.outputs, self.output_bytes = mapping(slave, 0x1C12)
        self.inputs, self.input_bytes = mapping(slave, 0x1C13)
        self.orders = {(0x6040, 0): 0, (0x6060, 0): CYCLIC_POSITION}

    def get(self, index, signed=False):
        at, size = self.inputs[(index, 0)]
        return int.from_bytes(self.slave.input[at : at + size], "little", signed=signed)

    def send(self):
        image = bytearray(self.output_bytes)
        for place, value in self.orders.items():
            if place in self.outputs:
                at, size = self.outputs[place]
                image[at : at + size] = value.to_bytes(size, "little", signed=value < 0)
        self.slave.output = bytes(image)

    def state(self):
        return self.get(0x6041) & 0x6F

    def position(self):
        return self.get(0x6064, signed=True)


class Rig:
    """One master for all checks, which follow one another."""

    def __init__(self):
        self.master = pysoem.Master()
        self.master.open(INTERFACE)
        self.master.sdo_read_timeout = PATIENCE_US
        self.emergencies = []

    def devices(self):
        equal(self.master.config_init(), 3)
        self.left, self.right, self.sensor = self.master.slaves
        self.drives = (self.left, self.right)
        for slave in self.master.slaves:
            slave.add_emergency_callback(self.emergencies.append)

    def identity(self):
        for slave in self.master.slaves:
            read = [struct.unpack("<I", slave.sdo_read(0x1018, sub))[0] for sub in (1, 2, 3)]
            equal(read, [slave.man, slave.id, slave.rev])
            equal(slave.sdo_read(0x1008, 0).rstrip(b"\0").decode(), slave.name)
        for drive in self.drives:
            equal(struct.unpack("<I", drive.sdo_read(0x1000, 0))[0] & 0xFFFF, 402)
        equal(self.left.id, self.right.id)
        assert self.sensor.id != self.left.id

    def long_object(self):
        # Longer than a mailbox: it comes in segments.
        complete = self.sensor.sdo_read(0x2040, 1, 512, True)
        equal(len(complete), 278)
        entries = self.sensor.sdo_read(0x2040, 0)[0]
        equal(b"".join(self.sensor.sdo_read(0x2040, sub) for sub in range(1, entries + 1)), complete)
        # The same as the value of one object, which is longer than a mailbox too.
        equal(self.sensor.sdo_read(0x2041, 0, 512), complete)
        # From the count of entries on, which takes two bytes.
        whole = self.sensor.sdo_read(0x2040, 0, 512, True)
        equal(whole[2:280], complete)
        counts_per_newton = struct.unpack_from("<i", complete, 8 + 30 + 8 + 30 + 4 * 36 + 2 + 4 * 6)[0]
        assert counts_per_newton > 0, counts_per_newton

    def written(self):
        drive = self.left
        before = drive.sdo_read(0x6085, 0)
        value = struct.pack("<I", struct.unpack("<I", before)[0] - 1)
        drive.sdo_write(0x6085, 0, value)
        equal(drive.sdo_read(0x6085, 0), value)
        drive.sdo_write(0x6085, 0, before)

    def abort(self):
        for at, code in [((0x5FFF, 0), 0x06020000), ((0x1018, 9), 0x06090011)]:
            try:
                self.left.sdo_read(*at)
            except pysoem.SdoError as error:
                equal(error.abort_code, code)
                assert error.desc, error
            else:
                raise AssertionError("no abort")
        try:
            self.left.sdo_write(0x1018, 1, bytes(4))
        except pysoem.SdoError as error:
            equal(error.abort_code, 0x06010002)
        else:
            raise AssertionError("no abort")

    def information(self):
        objects = self.left.od
        indices = [entry.index for entry in objects]
        for index in (0x1000, 0x1018, 0x1C12, 0x1C13, 0x6040, 0x6041, 0x607A):
            assert index in indices, f"{index:04X}h"
        (controlword,) = [entry for entry in objects if entry.index == 0x6040]
        equal(controlword.bit_length, 16)

    def clocks(self):
        self.map = [Drive(slave) for slave in self.drives]
        for slave in self.master.slaves:
            slave.set_watchdog("processdata", 1000)
        self.master.config_map()
        for drive in self.map:
            equal((len(drive.slave.output), len(drive.slave.input)), (drive.output_bytes, drive.input_bytes))
        assert self.master.config_dc(), "no distributed clocks"
        for slave in self.drives:
            slave.dc_sync(True, SYNC0_NS)
        equal(self.master.state_check(pysoem.SAFEOP_STATE, PATIENCE_US * 4), pysoem.SAFEOP_STATE)

    def operational(self):
        self.exchange = Exchange(self.master)
        for drive in self.map:
            drive.send()
        self.exchange.before = lambda: [drive.send() for drive in self.map]
        self.exchange.start()
        time.sleep(0.1)
        self.master.state = pysoem.OP_STATE
        self.master.write_state()
        self.reach(self.master.slaves, pysoem.OP_STATE)
        self.exchange.counters.clear()
        wait_for(lambda: len(self.exchange.counters) >= 500, 60)
        expected = self.master.expected_wkc
        assert expected >= 7, expected
        wrong = [counter for counter in self.exchange.counters if counter != expected]
        assert not wrong, f"{len(wrong)} of {len(self.exchange.counters)} counters are not {expected}: {wrong[:5]}"

    def reach(self, slaves, state):
        def is_there():
            self.master.read_state()
            return all(slave.state == state for slave in slaves)

        try:
            wait_for(is_there)
        except AssertionError:
            found = [f"{s.name}: {s.state:02X}h, {pysoem.al_status_code_to_string(s.al_status)}" for s in slaves]
            raise AssertionError("; ".join(found)) from None

    def enabled(self):
        for drive in self.map:
            equal(drive.state(), SWITCH_ON_DISABLED)
            drive.orders[(0x607A, 0)] = drive.position()
        for controlword, state in [(6, 0x21), (7, 0x23), (15, OPERATION_ENABLED)]:
            for drive in self.map:
                drive.orders[(0x607A, 0)] = drive.position()
                drive.orders[(0x6040, 0)] = controlword
            wait_for(lambda: all(drive.state() == state for drive in self.map))

    def moved(self):
        begin = [drive.position() for drive in self.map]
        steps = 400
        for step in range(1, steps + 1):
            for drive, start in zip(self.map, begin):
                drive.orders[(0x607A, 0)] = start + 5 * step
            time.sleep(PERIOD_S)
        goals = [start + 5 * steps for start in begin]
        wait_for(lambda: all(abs(drive.position() - goal) < 100 for drive, goal in zip(self.map, goals)))
        assert all(drive.state() == OPERATION_ENABLED for drive in self.map)

    def watchdog(self):
        self.exchange.stop()
        self.reach(self.drives, pysoem.SAFEOP_STATE | pysoem.STATE_ERROR)
        for slave in self.drives:
            equal(slave.al_status, 0x001B)
        # Inputs go on.
        self.master.send_processdata()
        self.master.receive_processdata(PATIENCE_US)
        for drive in self.map:
            assert drive.state() != OPERATION_ENABLED, f"{drive.state():02X}h"

    def emergency(self):
        for slave in self.drives:
            while slave.mbx_receive() > 0:
                pass
        told = {(emergency.slave_pos, emergency.error_code) for emergency in self.emergencies}
        equal({position for position, _ in told}, {1, 2})
        assert all(code != 0 for _, code in told), told

    def again(self):
        for slave in self.master.slaves:
            slave.state = pysoem.SAFEOP_STATE | pysoem.STATE_ACK
            slave.write_state()
        self.reach(self.master.slaves, pysoem.SAFEOP_STATE)
        for drive in self.map:
            drive.orders[(0x6040, 0)] = 0
        self.exchange.start()
        self.master.state = pysoem.OP_STATE
        self.master.write_state()
        self.reach(self.master.slaves, pysoem.OP_STATE)
        self.exchange.stop()

    def end(self):
        self.master.state = pysoem.INIT_STATE
        self.master.write_state()
        self.reach(self.master.slaves, pysoem.INIT_STATE)
        self.master.close()


def main():
    server = subprocess.Popen(ARGUMENTS, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    first = server.stdout.readline()
    print(first.strip(), flush=True)
    threading.Thread(target=lambda: sys.stdout.writelines(server.stdout), daemon=True).start()
    sniffer = None
    if CAPTURE:
        sniffer = subprocess.Popen(
            ["tshark", "-q", "-i", INTERFACE, "-f", "ether proto 0x88a4", "-a", "duration:600", "-F", "pcap", "-w", CAPTURE],
            stderr=subprocess.PIPE, text=True,
        )
        while "Capturing on" not in sniffer.stderr.readline():
            assert sniffer.poll() is None, "tshark ends"
        time.sleep(1)
    rig = Rig()
    for name, run in [
        ("pysoem finds two drives and a sensor", rig.devices),
        ("pysoem reads what they are, by SII and by SDO", rig.identity),
        ("pysoem reads 278 bytes by complete access, as one value, and each entry alone", rig.long_object),
        ("pysoem writes an object and reads it back", rig.written),
        ("pysoem decodes an abort", rig.abort),
        ("pysoem lists the objects of a drive", rig.information),
        ("pysoem maps process data and sets up distributed clocks", rig.clocks),
        ("pysoem reaches OP with the full working counter", rig.operational),
        ("pysoem enables both drives by controlword", rig.enabled),
        ("pysoem moves both in cyclic synchronous position", rig.moved),
        ("a stopped pysoem lets the watchdog of the sync manager stop both", rig.watchdog),
        ("pysoem hears the emergencies of both", rig.emergency),
        ("pysoem acknowledges and reaches OP again", rig.again),
        ("pysoem takes all to INIT", rig.end),
    ]:
        check(name, run)
        if failures:
            # Each check begins where the one before it ended.
            break
    exchange = getattr(rig, "exchange", None)
    if exchange and exchange.is_on:
        exchange.stop()
    if sniffer:
        time.sleep(1)
        sniffer.terminate()
        sniffer.wait()
    server.terminate()
    status = server.wait(timeout=20)
    if status not in (0, 130, -15):
        failures.append(f"the server ends with {status}")
    print(
        f"\ntest result: {'FAILED' if failures else 'ok'}. {passed} passed; {len(failures)} failed; 0 ignored; 0 measured; "
        f"0 filtered out; finished in {time.time() - begun:.2f}s",
        flush=True,
    )
    return len(failures)


if __name__ == "__main__":
    sys.exit(main())
