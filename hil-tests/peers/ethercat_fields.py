"""Holds what the codecs of this project read in captures of EtherCAT against what tshark reads, field by field.

    python3 hil-tests/peers/ethercat_fields.py FIELDS CAPTURE ..

FIELDS is the built program `fields` of hil-tests/ethercrab. A CAPTURE is a file of pcap, or the folder of a recording of a rig on EtherCAT and CAN:
there the frames of EtherCAT are read so, and what tshark reads on the CAN bus has to be the frames of bus.log. tshark must find nothing
malformed, and both must read the same in each frame. The exit status is the number of captures in which they do not.
"""

import os
import subprocess
import sys

# In the order of the columns of FIELDS.
NAMES = [
    "ecat.cmd", "ecat.idx", "ecat.adp", "ecat.ado", "ecat.lad", "ecat.int", "ecat.cnt",
    "ecat_mailbox.length", "ecat_mailbox.address", "ecat_mailbox.type", "ecat_mailbox.counter",
    "ecat_mailbox.coe.type", "ecat_mailbox.coe.sdoidx", "ecat_mailbox.coe.sdosub", "ecat_mailbox.coe.abortcode",
]  # fmt: skip
LEAST_FRAMES = 1000


def lines(*command):
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, f"{command[0]}: {done.stderr}"
    return done.stdout.splitlines()


def numbers(line):
    return [[int(value, 0) for value in column.split(",") if value] for column in line.split("\t")]


def judge(fields, capture):
    malformed = lines("tshark", "-n", "-r", capture, "-Y", "_ws.malformed")
    assert not malformed, f"tshark finds {len(malformed)} malformed frames, such as {malformed[0]}"
    arguments = [argument for name in NAMES for argument in ("-e", name)]
    theirs = lines("tshark", "-n", "-r", capture, "-Y", "eth.type == 0x88a4", "-T", "fields", "-E", "occurrence=a", *arguments)
    ours = lines(fields, capture)
    assert len(ours) == len(theirs) >= LEAST_FRAMES, f"{len(ours)} and {len(theirs)} frames"
    different, mailboxes = [], 0
    for number, (our, their) in enumerate(zip(ours, theirs), 1):
        our, their = numbers(our), numbers(their)
        mailboxes += bool(our[7])
        for name, one, other in zip(NAMES, our, their):
            if one != other:
                different.append(f"frame {number}, {name}: ours {one}, theirs {other}")
    assert not different, f"{len(different)} fields differ: " + "; ".join(different[:5])
    return f"{len(ours)} frames, {mailboxes} of them with a mailbox, {len(NAMES)} fields each"


def judge_recording(fields, folder):
    capture = os.path.join(folder, "bus.pcapng")
    names = lines("capinfos", "-I", capture)
    names = [line.split("=", 1)[1].strip() for line in names if line.strip().startswith("Name =")]
    columns = [argument for name in ["frame.time_epoch", "can.id", "can.len", "data"] for argument in ("-e", name)]
    seen = lines("tshark", "-n", "-r", capture, "--disable-protocol", "autosar-nm", "-Y", "can", "-T", "fields", "-E", "occurrence=f", *columns)
    theirs = []
    for line in seen:
        time, number, length, data = line.split("\t")
        theirs.append((time.split(".")[0].lstrip("0") + "." + time.split(".")[1][:6], int(number, 0), int(length), data))
    ours = []
    with open(os.path.join(folder, "bus.log")) as log:
        for line in log:
            time, _, frame = line.split()
            number, data = frame.split("#")
            ours.append((time[1:-1].lstrip("0"), int(number, 16), len(data) // 2, data.lower()))
    assert ours == theirs, f"{len(ours)} and {len(theirs)} frames of CAN; the first that differ: " + str(
        next((pair for pair in zip(ours, theirs) if pair[0] != pair[1]), "none")
    )
    assert len(names) == 2 and len(ours) >= LEAST_FRAMES, f"buses {names}, {len(ours)} frames of CAN"
    return f"buses {names}, {len(ours)} frames of CAN; {judge(fields, capture)}"


failed = 0
for capture in sys.argv[2:]:
    try:
        told = (judge_recording if os.path.isdir(capture) else judge)(sys.argv[1], capture)
        print(f"ok    tshark reads {capture.rsplit('/', 1)[-1]} as we do: {told}", flush=True)
    except AssertionError as error:
        failed += 1
        print(f"FAIL  {capture}: {error}", flush=True)
sys.exit(failed)
