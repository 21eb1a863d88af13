"""Holds what the codecs of this project read in captures of EtherCAT against what tshark reads, field by field.

    python3 hil-tests/peers/ethercat_fields.py FIELDS CAPTURE.pcap ..

FIELDS is the built program `fields` of hil-tests/ethercrab. tshark must find nothing malformed, and both must read the same in each frame.
The exit status is the number of captures in which they do not.
"""

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
    theirs = lines("tshark", "-n", "-r", capture, "-T", "fields", "-E", "occurrence=a", *arguments)
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


failed = 0
for capture in sys.argv[2:]:
    try:
        print(f"ok    tshark reads {capture.rsplit('/', 1)[-1]} as we do: {judge(sys.argv[1], capture)}", flush=True)
    except AssertionError as error:
        failed += 1
        print(f"FAIL  {capture}: {error}", flush=True)
sys.exit(failed)
