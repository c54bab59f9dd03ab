"""Small recordings of trackers, of our own making, in the forms in which they are exported."""
# ruff: noqa: E501  (lines are as long as the exported ones)

import struct

import numpy as np

#: Two frames of markers and of a rigid body, as Motive 2 writes them: P1 is hidden in the second frame, and what the
#: body's model expects of it stays.
MOTIVE = """\
Format Version,1.23,Take Name,t,Capture Frame Rate,100.000000,Rotation Type,Quaternion,Length Units,Meters,Coordinate Space,Global

,Type,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body Marker,Rigid Body Marker,Rigid Body Marker,Rigid Body Marker,Marker,Marker,Marker,Marker,Marker,Marker
,Name,plate,plate,plate,plate,plate,plate,plate,plate,plate:P1,plate:P1,plate:P1,plate:P1,plate:P1,plate:P1,plate:P1,P2,P2,P2
,ID,"A","A","A","A","A","A","A","A","B","B","B","B","C","C","C","D","D","D"
,,Rotation,Rotation,Rotation,Rotation,Position,Position,Position,Mean Marker Error,Position,Position,Position,Marker Quality,Position,Position,Position,Position,Position,Position
Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,,X,Y,Z,,X,Y,Z,X,Y,Z
0,0.000000,0,0,0.70710678,0.70710678,0.01,0.02,0.03,0.0002,0.5,0.5,0.5,1,0.030,0.010,0.040,0.000,0.010,0.040
1,0.010000,0,0,0.70710678,0.70710678,0.01,0.02,0.04,0.0002,0.5,0.5,0.5,0,,,,0.001,0.010,0.040
"""

#: Two tools in a row, as NDI Track writes them; one is missing in the second frame.
NDI_TRACK = """\
Tools,Port 1,Frame,Face,State,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error,Port 2,Frame,Face,State,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error
2,,120,0,OK,0.70710678,0,0,0.70710678,30,10,40,0.25,,120,0,OK,1,0,0,0,0,10,40,0.1
2,,126,0,OK,0.70710678,0,0,0.70710678,31,10,40,0.25,,126,0,Missing,,,,,,,,
2,,132,0,Disabled,,,,,,,,,,132,0,OK,1,0,0,0,1,10,40,0.1
"""

#: A tool a row, as samples of the Combined API write them; a missing tool has one cell less before its state.
NDI_ROWS = """\
Frame#,ToolHandle,Face#,TransformStatus,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error,#Markers,State,Tx,Ty,Tz
120,Port:1,0,OK,0.70710678,0,0,0.70710678,30,10,40,0.25,1,OK,1,2,3
120,Port:2,0,OK,1,0,0,0,0,10,40,0.1,0
126,Port:1,0,OK,0.70710678,0,0,0.70710678,31,10,40,0.25,0
126,Port:2,Missing,,,,,,,,,0
132,Port:1,Missing,,,,,,,,,0
132,Port:2,0,OK,1,0,0,0,1,10,40,0.1,0
"""

#: A newer Track: tools have names, each row its time, and markers of each tool follow its error.
NDI_TIMED = """\
Tools,Port 0x01: Probe  s/n:3E4C,Frame,Time [sec],Face,State,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error,Markers,State,Tx,Ty,Tz,Port 0x02: Bone  s/n:3E4D,Frame,Time [sec],Face,State,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error,Markers,State,Tx,Ty,Tz
2,Port 0x01: Probe  s/n:3E4C,120,1700000000.250000000,1,OK,0.70710678,0,0,0.70710678,30,10,40,0.25,1,OK,1,2,3,Port 0x02: Bone  s/n:3E4D,120,1700000000.250000000,1,OK,1,0,0,0,0,10,40,0.1,1,OK,1,2,3
2,Port 0x01: Probe  s/n:3E4C,123,1700000000.500000000,1,Too Few Markers,-3.697314E28,-3.697314E28,-3.697314E28,-3.697314E28,-3.697314E28,-3.697314E28,-3.697314E28,0.0000000,1,Off Angle,1,2,3,Port 0x02: Bone  s/n:3E4D,123,1700000000.500000000,1,OK,1,0,0,0,1,10,40,0.1,1,OK,1,2,3
"""

#: An older sample of the Combined API: the header is that of one tool, a row counts its tools and the markers of each.
NDI_COUNTED = """\
#Tools,ToolInfo,Frame#,PortHandle,Face#,TransformStatus,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error,Markers,State,Tx,Ty,Tz
2,8700338 s/n:1,120,Port:1,0,OK,0.70710678,0,0,0.70710678,30,10,40,0.25,2,OK,1,2,3,OK,4,5,6,8700340 s/n:2,120,Port:2,0,OK,1,0,0,0,0,10,40,0.1,0
2,8700338 s/n:1,126,Port:1,Missing,,,,,,,,,2,Missing,,,,OK,4,5,6,8700340 s/n:2,125,Port:2,0,OK,1,0,0,0,1,10,40,0.1,0
"""

TRC = (
    "PathFileType\t4\t(X/Y/Z)\tt.trc\n"
    "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames\n"
    "60.00\t60.00\t2\t2\tcm\t60.00\t1\t2\n"
    "Frame#\tTime\tP1\t\t\tP2\t\t\n"
    "\t\tX1\tY1\tZ1\tX2\tY2\tZ2\n"
    "\n"
    "1\t0.000\t3\t1\t4\t0\t1\t4\n"
    "2\t0.017\t\t\t\t0.1\t1\t4\n"
)

#: A table of nobody's format, with a line before its header.
ANY_TABLE = "made by hand\nn;t (ms);A x;A y;A z;B x;B y;B z\n1;0;3;1;4;0;1;4\n2;20;;;;0,1;1;4\n"
ANY_COLUMNS = "time=t (ms) P1.x=A x P1.y=A y P1.z=A z P2.x=B x P2.y=B y P2.z=B z unit=cm time_unit=ms"


def plus_text(poses, statuses=None, ending="LOCAL"):
    """A sequence of PLUS; `poses`: of each tool, (n_frames, 4, 4); `statuses`: of each tool, a word a frame."""
    n = len(next(iter(poses.values())))
    lines = ["ObjectType = Image", "NDims = 3", f"DimSize = 1 1 {n}", "ElementType = MET_UCHAR", "Offset = 0 0 0"]
    for k in range(n):
        for tool, found in poses.items():
            numbers = " ".join(repr(float(one)) for one in np.ravel(found[k]))
            status = "OK" if statuses is None else statuses[tool][k]
            lines.append(f"Seq_Frame{k:04d}_{tool}ToTrackerTransform = {numbers} ")
            lines.append(f"Seq_Frame{k:04d}_{tool}ToTrackerTransformStatus = {status}")
        lines.append(f"Seq_Frame{k:04d}_Timestamp = {5.0 + 0.05 * k}")
        lines.append(f"Seq_Frame{k:04d}_ImageStatus = OK")
    return "\n".join([*lines, f"ElementDataFile = {ending}\n"])


def c3d_bytes(places, names, *, rate=50.0, floats=True, order="<", unit="mm", scale=0.01, up="+Z"):
    """A .c3d file of places (n_frames, n_points, 3), NaN where missing, as the format's manual lays it out."""
    processor = {"<": 84, ">": 86, "dec": 85}[order]
    dec, order = order == "dec", "<" if order == "dec" else order
    n_frames, n_points = places.shape[:2]
    length = max(len(name) for name in names)

    def number(value):
        raw = np.asarray(value, order + "f4").ravel()
        # DEC's floats have the two words exchanged, and an exponent that is larger by two.
        return (4.0 * raw).astype("<f4").view("<u2").reshape(-1, 2)[:, ::-1].tobytes() if dec else raw.tobytes()

    def parameter(group, name, kind, shape, data):
        body = struct.pack("bB", kind, len(shape)) + bytes(shape) + data + b"\0"
        return struct.pack("bb", len(name), group) + name.encode() + struct.pack(order + "h", 2 + len(body)) + body

    group = struct.pack("bb", 5, -1) + b"POINT" + struct.pack(order + "h", 3) + b"\0"
    section = group
    for k in range(0, n_points, 255):  # as many as a parameter holds
        some = names[k : k + 255]
        labels = "".join(name.ljust(length) for name in some).encode()
        section += parameter(1, "LABELS" + (str(1 + k // 255) if k else ""), -1, (length, len(some)), labels)
    section += parameter(1, "UNITS", -1, (len(unit),), unit.encode())
    section += parameter(1, "Y_SCREEN", -1, (2,), up.encode())
    section += parameter(1, "RATE", 4, (), number(rate))
    section = bytes([0, 0x50, 1 + len(section) // 512, processor]) + section + b"\0\0"
    section = section.ljust(512 * (1 + len(section) // 512), b"\0")
    start = 2 + len(section) // 512
    head = bytes([2, 0x50]) + struct.pack(order + "5H", n_points, 0, 1, n_frames, 0)
    head += number(-scale if floats else scale) + struct.pack(order + "HH", start, 0) + number(rate)
    missing = np.isnan(places).any(axis=2)
    numbers = np.dstack([np.where(missing[..., None], 0.0, places), np.where(missing, -1.0, 0.0)])
    if not floats:
        numbers[..., :3] /= scale
    points = number(numbers) if floats else np.rint(numbers).astype(order + "i2").tobytes()
    return head.ljust(512, b"\0") + section + points
