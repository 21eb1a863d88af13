"""Drives of python-canopen, commissioned and jogged by the wall clock, each with a watchdog of its own over the master's heartbeat.

They are at once where they are told to be, make no torque and tell none: what needs one is refused by name.
"""

import json
import math
import os
import pathlib
import subprocess
import tempfile
import threading
import time

import canopen

import drives

MASTER = 127
PERIOD_MS = 100
# How often a command is tried that a computer which stands still for a moment can spoil, and the faults by which that shows.
TRIES = 4
LATE = ("overrun", "pdo-late", "pdo-missed", "stalled", "heartbeat-lost")
# As slow as a computer without a real-time kernel keeps it, whatever else it does.
RIG = f"""\
like: builtin:paper-admittance.yaml
rig: {{name: foreign, command_mode: position}}
cycle: {{period_us: {PERIOD_MS * 1000}, compute_at_us: {PERIOD_MS * 500}}}
buses: {{main: {{canopen: {{heartbeat_ms: 200}}}}}}
drives:
  - {{name: left, profile: found.yaml, encoder: multi_turn, address: {{canopen: {{heartbeat_ms: 200}}}}}}
  - {{name: right, profile: found.yaml, encoder: multi_turn, address: {{canopen: {{heartbeat_ms: 200}}}}}}
sensor:
  protocol: {{canopen: {{heartbeat_ms: 200}}}}
  sample_rate_hz: 200
guard: {{tool_speed_limit_m_per_s: 0.25, force_limit_n: 140.0}}
"""


class ByTheClock:
    """A device that sends its heartbeats by the clock, as python-canopen does by itself."""

    def beat(self):
        pass


class Watched(ByTheClock, drives.Drive):
    """It stops by itself when the master's heartbeat stays away for the time in 1016h:1, and sends its own by the clock."""

    def __init__(self, network, node_id, position):
        objects = canopen.import_od(str(drives.FOREIGN), node_id)
        # Two devices of one kind, as on a bench.
        objects[0x1018][4].value = 7000 + node_id
        self.heard = None
        super().__init__(network, node_id, objects, position)
        network.subscribe(0x700 + MASTER, self.on_heartbeat)
        threading.Thread(target=self.watch, daemon=True).start()

    def boot(self):
        self.heard = None
        super().boot()

    def on_heartbeat(self, _id, _data, _time):
        self.heard = time.monotonic()

    def watch(self):
        while True:
            time.sleep(0.005)
            limit_s = (self.node.sdo[0x1016][1].raw & 0xFFFF) / 1000
            heard = self.heard
            if limit_s and heard and time.monotonic() - heard > limit_s and self.state != "SWITCH ON DISABLED":
                self.state = "SWITCH ON DISABLED"
                self.states.append(self.state)

    def step(self):
        values = super().step()
        # Over SDO as well, by which a drill asks where no SYNC is.
        self.node.set_data(0x6041, 0, values[0x6041, 0].to_bytes(2, "little"))
        return values


class Sensor(ByTheClock, drives.Sensor):
    """As that of lockstep, but for its heartbeats."""


def commissioned(programs, interface):
    """Adopted by their data sheet, then commissioned as far as they go, each refusal named; then one joint is jogged."""
    positions = drives.first_positions(programs)
    network = drives.connect(interface)
    both = [Watched(network, node, positions[node]) for node in (drives.LEFT, drives.RIGHT)]
    Sensor(network, (0x0002_0194, drives.VENDOR, 0x404))
    sheet = str(drives.FOREIGN)
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"XDG_STATE_HOME": f"{folder}/state"}
        profile, rig, dump = (f"{folder}/{name}" for name in ("found.yaml", "rig.yaml", "left.dcf"))

        def said(*arguments, codes=(0,)):
            command = [f"{programs}/yieldwall", "--json", *arguments, "--bus", interface]
            ended = subprocess.run(command, capture_output=True, text=True, timeout=200, env=environment)
            assert ended.returncode in codes, f"{arguments}: {ended.returncode}: {ended.stdout}{ended.stderr}"
            return json.loads(ended.stdout)

        def in_time(*arguments):
            """Tried again where this computer was too late."""
            for attempt in range(1, TRIES + 1):
                document = said(*arguments, "--ignore-latency", codes=(0, 7, 8, 9) if attempt < TRIES else (0,))
                if document["exit_code"] == 0:
                    return document
                assert any(word in json.dumps(document) for word in LATE), document

        try:
            said("drive", "adopt", "--node", "1", "--eds", sheet, "--out", profile, "--name", "found")
            pathlib.Path(rig).write_text(RIG, encoding="utf-8")
            said("od", "dump", "1", "--eds", sheet, "--out", dump)
            # Without a record of their watchdogs they are not moved.
            refused = said("jog", rig, "left", "--by", "3deg", "--ignore-latency", codes=(5,))["diagnostics"][0]
            assert "no watchdog drill is on record" in refused["message"], refused
            steps = {step["step"]: step for step in in_time("commission", rig, "--yes")["steps"]}
            passed = [name for name, step in steps.items() if step["verdict"] == "pass"]
            assert passed == ["communication", "identity", "limits", "parameters", "sensor-rest", "watchdogs", "admittance"], steps
            for name, why in (
                ("sensor-axes", "nobody can pull at the tool with a known force"),
                ("rotation", "nobody measured the turn"),
                ("motor", "the drive left does not report its torque (6077h)"),
                ("friction", "the drive left does not report its torque (6077h)"),
            ):
                step = steps[name]
                assert step["verdict"] == "skipped" and why in step["reason"], step
            found = steps["watchdogs"]["evidence"]
            assert found["without SYNC"] == "left goes on, right goes on", found
            assert "left stops after" in found["without heartbeat"], found
            assert "left: turned" in steps["rotation"]["evidence"], "no joint was moved"
            jogged = in_time("jog", rig, "left", "--by", "3deg")
            way = [to - since for to, since in zip(jogged["to_rad"], jogged["from_rad"])]
            assert abs(math.degrees(way[0]) - 3) < 0.1 and abs(way[1]) < 1e-3, jogged
            # What was written to them is as it was, but for what process data carry.
            differing = said("od", "diff", "1", dump, "--eds", sheet, codes=(0, 7))["differences"]
            assert all(one["object"][:5] in ("6040h", "607Ah") for one in differing), differing
        finally:
            network.disconnect()
    for drive in both:
        assert "OPERATION ENABLED" in drive.states and drive.state != "OPERATION ENABLED", drive.states
