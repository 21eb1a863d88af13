"""CiA 402 between this project and python-canopen: their master on our simulated drive, our master on their devices.

Theirs is the SDO server, NMT, heartbeat, emergencies and the process data as the master has mapped them; the state machine of
a drive, which python-canopen has for masters alone, is a table here.
"""

import json
import pathlib
import subprocess
import tempfile
import time

import canopen
from canopen import objectdictionary as od

RIG = "config/paper-admittance-csp.yaml"
FOREIGN = pathlib.Path(__file__).with_name("foreign_servo.eds")
LEFT, RIGHT, SENSOR = 1, 2, 10
VENDOR = 0xFFFF_5957
SIMULATED = [int.from_bytes(b"simulated device"[n : n + 4], "little") for n in range(0, 16, 4)]
SENSOR_STATUS, SAMPLE_COUNTER = 0x2001, 0x2002

PDO = [
    (0, "Highest sub-index", od.UNSIGNED8, 5),
    (1, "COB-ID", od.UNSIGNED32, 0x8000_0000),
    (2, "Transmission type", od.UNSIGNED8, 1),
    (3, "Inhibit time", od.UNSIGNED16, 0),
    (5, "Event timer", od.UNSIGNED16, 0),
]
MAPPING = [(0, "Number of entries", od.UNSIGNED8, 0)] + [(n, f"Entry {n}", od.UNSIGNED32, 0) for n in range(1, 9)]
ENTRIES = {
    0x1001: ("Error register", od.UNSIGNED8, 0),
    0x1017: ("Producer heartbeat time", od.UNSIGNED16, 0),
    0x1016: ("Consumer heartbeat time", [(0, "Highest", od.UNSIGNED8, 1), (1, "Node 1", od.UNSIGNED32, 0)]),
    0x1029: ("Error behaviour", [(0, "Highest", od.UNSIGNED8, 1), (1, "Communication error", od.UNSIGNED8, 0)]),
    0x2010: ("Watchdogs that it lacks", od.UNSIGNED8, 0),
    0x2011: ("Its time follows SYNC", od.UNSIGNED8, 1),
    0x2012: (
        "Mark of a simulated device",
        [(0, "Highest", od.UNSIGNED8, 4)] + [(n, f"Word {n}", od.UNSIGNED32, word) for n, word in enumerate(SIMULATED, 1)],
    ),
    0x6007: ("Abort connection option", od.INTEGER16, 0),
    0x6040: ("Controlword", od.UNSIGNED16, 0),
    0x6041: ("Statusword", od.UNSIGNED16, 0),
    0x605A: ("Quick stop option", od.INTEGER16, 2),
    0x6060: ("Modes of operation", od.INTEGER8, 0),
    0x6061: ("Modes of operation display", od.INTEGER8, 0),
    0x6064: ("Position actual value", od.INTEGER32, 0),
    0x6065: ("Following error window", od.UNSIGNED32, 0),
    0x6072: ("Max torque", od.UNSIGNED16, 0),
    0x6080: ("Max motor speed", od.UNSIGNED32, 3000),
    0x608F: (
        "Encoder resolution",
        [(0, "Highest", od.UNSIGNED8, 2), (1, "Increments", od.UNSIGNED32, 800_000), (2, "Revolutions", od.UNSIGNED32, 1)],
    ),
    0x607A: ("Target position", od.INTEGER32, 0),
    0x60C2: (
        "Interpolation time",
        [(0, "Highest", od.UNSIGNED8, 2), (1, "Value", od.UNSIGNED8, 1), (2, "Exponent", od.INTEGER8, -3)],
    ),
    0x6502: ("Supported drive modes", od.UNSIGNED32, 1 << 7),
    0x7130: (
        "Process value",
        [(0, "Highest", od.UNSIGNED8, 6)] + [(n, f"Channel {n}", od.INTEGER16, 0) for n in range(1, 7)],
    ),
    0x1400: ("RPDO 1", PDO),
    0x1600: ("RPDO 1 mapping", MAPPING),
    0x1800: ("TPDO 1", PDO),
    0x1A00: ("TPDO 1 mapping", MAPPING),
    0x1801: ("TPDO 2", PDO),
    0x1A01: ("TPDO 2 mapping", MAPPING),
}


def dictionary(identity=None, extra=None):
    """The objects of a drive or a sensor; `identity` is device type, vendor and product."""
    objects = od.ObjectDictionary()
    entries = ENTRIES | (extra or {})
    if identity:
        device_type, vendor, product = identity
        entries[0x1000] = ("Device type", od.UNSIGNED32, device_type)
        numbers = [("Highest", 4), ("Vendor", vendor), ("Product", product), ("Revision", 1), ("Serial", 1)]
        subs = [(n, name, od.UNSIGNED32 if n else od.UNSIGNED8, value) for n, (name, value) in enumerate(numbers)]
        entries[0x1018] = ("Identity", subs)

    def variable(name, index, sub, data_type, value):
        result = od.ODVariable(name, index, sub)
        result.data_type, result.access_type, result.value = data_type, "rw", value
        return result

    for index, (name, *rest) in entries.items():
        if len(rest) == 2:
            objects.add_object(variable(name, index, 0, *rest))
            continue
        record = od.ODRecord(name, index)
        for sub, sub_name, data_type, value in rest[0]:
            record.add_member(variable(sub_name, index, sub, data_type, value))
        objects.add_object(record)
    return objects


def connect(interface):
    network = canopen.Network()
    network.connect(interface="socketcan", channel=interface)
    return network


def wait_until(what, is_so, seconds=10):
    end = time.time() + seconds
    while not is_so():
        assert time.time() < end, f"not within {seconds} s: {what}"
        time.sleep(0.005)


def ours(programs, interface):
    """Their CiA 402 master with our simulated drive, whose time advances by 1 ms with each SYNC, however slow the machine."""
    network = connect(interface)
    node = canopen.BaseNode402(LEFT, dictionary())
    network.add_node(node)
    node.TIMEOUT_CHECK_TPDO = node.TIMEOUT_SWITCH_STATE_SINGLE = node.TIMEOUT_SWITCH_STATE_FINAL = 10
    command = [f"{programs}/yieldwall", "sim", RIG, "--bus", interface, "--pace", "lockstep"]
    simulation = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    try:
        node.nmt.wait_for_bootup(20)
        # The drive's own process data are the two words alone.
        node.pdo.read()
        for pdo, objects in ((node.rpdo[1], (0x6040, 0x607A)), (node.tpdo[1], (0x6041, 0x6064))):
            pdo.clear()
            for index in objects:
                pdo.add_variable(index)
            pdo.trans_type, pdo.enabled = 1, True
            pdo.save()
        node.setup_402_state_machine()
        assert 0x6040 in node.rpdo_pointers and 0x6041 in node.tpdo_values, "no words in the process data"
        network.sync.start(0.005)
        node.nmt.state = "OPERATIONAL"
        node.op_mode = "CYCLIC SYNCHRONOUS POSITION"
        begin = node.sdo[0x6064].raw
        target = node.rpdo_pointers[0x607A]
        target.raw = begin
        # From now on what changes in it goes out by itself.
        node.rpdo[1].start(0.005)
        for state in ("READY TO SWITCH ON", "SWITCHED ON", "OPERATION ENABLED"):
            node.state = state
            assert node.state == state, f"{node.state} instead of {state}"
        for step in range(1, 51):
            target.raw = begin + 40 * step
            time.sleep(0.005)
        wait_until("the drive is there", lambda: abs(node.tpdo_pointers[0x6064].raw - begin - 2000) < 200)
        network.sync.stop()
        emergency = node.emcy.wait(timeout=10)
        assert emergency is not None and emergency.code != 0, "no word of the lost SYNC"
        network.sync.start(0.005)
        wait_until("the fault shows", lambda: node.state == "FAULT")
        target.raw = node.tpdo_pointers[0x6064].raw
        node.reset_from_fault()
        wait_until("the drive is enabled again", lambda: node.state == "OPERATION ENABLED")
        node.state = "SWITCH ON DISABLED"
    finally:
        network.sync.stop()
        node.rpdo[1].stop()
        network.disconnect()
        simulation.kill()
        simulation.wait()


class Device:
    """A LocalNode that boots as a device does and sends its process data with each SYNC."""

    def __init__(self, network, node_id, objects):
        self.node = canopen.LocalNode(node_id, objects)
        network.add_node(self.node)
        network.subscribe(0x000, self.on_nmt)
        network.subscribe(0x080, self.on_sync)
        self.received, self.syncs = {}, 0
        self.boot()

    def boot(self):
        self.node.nmt.stop_heartbeat()
        self.node.data_store.clear()
        self.node.nmt.state = "INITIALISING"
        self.node.nmt.state = "PRE-OPERATIONAL"

    def on_nmt(self, _id, data, _time):
        command, target = data
        if target not in (0, self.node.id):
            return
        if command in (0x81, 0x82):
            self.boot()
        elif command == 0x01:
            # As the master has mapped them.
            self.node.tpdo.read()
            self.node.rpdo.read()
            self.received = {entry.index: entry for pdo in self.node.rpdo.values() if pdo.enabled for entry in pdo}

    def on_sync(self, _id, _data, _time):
        if self.node.nmt.state != "OPERATIONAL":
            return
        self.syncs += 1
        self.beat()
        values = self.step()
        for pdo in self.node.tpdo.values():
            if pdo.enabled:
                for entry in pdo:
                    entry.raw = values[entry.index, entry.subindex]
                pdo.transmit()


    def beat(self):
        """As everything in lockstep, heartbeats follow SYNC, of which there is one each ms; before the first the wall."""
        self.node.nmt.stop_heartbeat()
        if self.syncs % self.node.sdo[0x1017].raw == 1:
            self.node.network.send_message(0x700 + self.node.id, [0x05])


class Drive(Device):
    """A drive that is at once where it is told to be."""

    WORDS = {
        "SWITCH ON DISABLED": 0x0250,
        "READY TO SWITCH ON": 0x0231,
        "SWITCHED ON": 0x0233,
        "OPERATION ENABLED": 0x1237,
    }
    # Mask and value of the controlword, and where it leads to.
    WAYS = {
        "SWITCH ON DISABLED": [(0x87, 0x06, "READY TO SWITCH ON")],
        "READY TO SWITCH ON": [(0x8F, 0x07, "SWITCHED ON"), (0x8F, 0x0F, "SWITCHED ON")],
        "SWITCHED ON": [(0x8F, 0x0F, "OPERATION ENABLED"), (0x87, 0x06, "READY TO SWITCH ON")],
        "OPERATION ENABLED": [(0x8F, 0x07, "SWITCHED ON"), (0x87, 0x06, "READY TO SWITCH ON")],
    }
    WAYS_OUT = [(0x82, 0x00, "SWITCH ON DISABLED"), (0x86, 0x02, "SWITCH ON DISABLED")]

    def __init__(self, network, node_id, objects, position):
        self.state, self.states, self.position = "SWITCH ON DISABLED", [], position
        super().__init__(network, node_id, objects)
        self.node.add_write_callback(self.on_write)

    def on_write(self, index, data, **_rest):
        if index == 0x6060:
            self.node.set_data(0x6061, 0, data)

    def step(self):
        word = self.received[0x6040].raw
        for mask, value, state in self.WAYS[self.state] + self.WAYS_OUT:
            if word & mask == value and state != self.state:
                self.state = state
                self.states.append(state)
                break
        if self.state == "OPERATION ENABLED":
            self.position = self.received[0x607A].raw
        return {(0x6041, 0): self.WORDS[self.state], (0x6064, 0): self.position}


class Sensor(Device):
    """A sensor that feels nothing but its noise."""

    def __init__(self, network, identity):
        names = {SENSOR_STATUS: "Status", SAMPLE_COUNTER: "Sample counter"}
        extra = {index: (name, od.UNSIGNED8, 0) for index, name in names.items()}
        super().__init__(network, SENSOR, dictionary(identity, extra))

    def step(self):
        noise = [(self.syncs * prime >> 4) % 3 - 1 for prime in (7, 11, 13, 17, 19, 23)]
        values = {(0x7130, channel): count for channel, count in enumerate(noise, 1)}
        return values | {(SENSOR_STATUS, 0): 0, (SAMPLE_COUNTER, 0): self.syncs % 256}


def first_positions(programs):
    """Where the drives of the rig are when they are switched on, as the embedded simulation has it."""
    with tempfile.NamedTemporaryFile(suffix=".log") as log:
        command = [f"{programs}/yieldwall", "run", RIG, "--duration", "0.01", "--candump", log.name]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        positions = {}
        for line in open(log.name, encoding="ascii"):
            identifier, data = line.split()[2].split("#")
            if identifier in ("181", "182"):
                position = int.from_bytes(bytes.fromhex(data)[2:6], "little", signed=True)
                positions.setdefault(int(identifier, 16) - 0x180, position)
        return positions


def theirs(programs, interface):
    """Our master with their drives and sensor."""
    positions = first_positions(programs)
    network = connect(interface)
    identity = (0x0002_0192, VENDOR, 0x402)
    drives = [Drive(network, node, dictionary(identity), positions[node]) for node in (LEFT, RIGHT)]
    sensor = Sensor(network, (0x0002_0194, VENDOR, 0x404))
    try:
        command = [f"{programs}/yieldwall", "--json", "run", RIG, "--bus", interface, "--pace", "lockstep"]
        run = subprocess.run([*command, "--duration", "0.5"], capture_output=True, text=True, timeout=60)
        said = run.stdout + run.stderr
        assert run.returncode == 0, said
        json.loads(run.stdout)
        for drive in drives:
            assert drive.states[:3] == ["READY TO SWITCH ON", "SWITCHED ON", "OPERATION ENABLED"], drive.states
            assert drive.state != "OPERATION ENABLED", "left enabled at the end"
            assert int.from_bytes(drive.node.get_data(0x6061, 0), "little") == 8, "not in position mode"
            assert drive.syncs > 500, f"{drive.syncs} SYNC"
        assert sensor.syncs == drives[0].syncs
    finally:
        network.disconnect()


def foreign(node_id):
    """The objects of the data sheet, and those by which a simulated device says that it is one."""
    objects = canopen.import_od(str(FOREIGN), node_id)
    marks = dictionary()
    for index in (0x2010, 0x2011, 0x2012):
        objects.add_object(marks[index])
    return objects


def adopted(programs, interface):
    """Drives with a data sheet of others are scanned, read, adopted and run by the profile that was found, from files alone."""
    positions = first_positions(programs)
    network = connect(interface)
    drives = [Drive(network, node, foreign(node), positions[node]) for node in (LEFT, RIGHT)]
    Sensor(network, (0x0002_0194, VENDOR, 0x404))

    def well(*arguments, on=interface, code=0):
        place = ["--bus", on] if on else []
        command = [f"{programs}/yieldwall", "--json", *arguments, *place]
        ended = subprocess.run(command, capture_output=True, text=True, timeout=100)
        assert ended.returncode == code, f"{arguments}: {ended.returncode}: {ended.stdout}{ended.stderr}"
        return json.loads(ended.stdout)

    try:
        with tempfile.TemporaryDirectory() as folder:
            profile, rig, dump = (f"{folder}/{name}" for name in ("found.yaml", "rig.yaml", "left.dcf"))
            nodes = well("scan")["nodes"]
            assert [node["node_id"] for node in nodes] == [LEFT, RIGHT, SENSOR], nodes
            assert nodes[0]["name"] == "SV-200 C", nodes
            read = well("od", "read", "1", "pole-pairs", "Max Torque", "6041h", "--eds", str(FOREIGN))["objects"]
            assert [one["value"].split()[0] for one in read] == ["10", "1000", "592"], read
            # What the drive does not have is refused by name.
            absent = well("od", "read", "1", "2031h:7", "--eds", str(FOREIGN), code=5)
            assert "06090011h" in absent["objects"][0]["error"], absent
            well("od", "dump", "1", "--eds", str(FOREIGN), "--out", dump)
            before = well("od", "diff", "1", dump, "--eds", str(FOREIGN))["differences"]
            assert before == [], before
            found = well("drive", "adopt", "--node", "1", "--eds", str(FOREIGN), "--out", profile, "--name", "found")
            assert found["modes"] == ["CSP"] and found["mapping_entries"] == 8, found
            # Their server takes any value and any mapping, whatever the data sheet says.
            says = " ".join(found["contradictions"])
            for line in ("dummy entries of one byte: no by the data sheet", "Abort Connection Option Code: 0 to 2 by"):
                assert line in says, found["contradictions"]
            assert any("1400h:5" in line for line in found["missing"]), found["missing"]
            after = well("od", "diff", "1", dump, "--eds", str(FOREIGN))["differences"]
            assert after == [], after
            # A person writes what the drive cannot tell.
            well("config", "check", profile, on=None)
            show = [f"{programs}/yieldwall", "config", "show", "builtin:paper-admittance-csp.yaml"]
            text = subprocess.run(show, capture_output=True, text=True, check=True).stdout
            text = text.replace("profile: simulated-servo", "profile: found.yaml\n  encoder: multi_turn")
            pathlib.Path(rig).write_text(text, encoding="utf-8")
            well("run", rig, "--pace", "lockstep", "--duration", "0.3")
        for drive in drives:
            assert drive.states[:3] == ["READY TO SWITCH ON", "SWITCHED ON", "OPERATION ENABLED"], drive.states
            assert drive.state != "OPERATION ENABLED", "left enabled at the end"
    finally:
        network.disconnect()
