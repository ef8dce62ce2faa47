import pytest

from deploy.puck.properties import number
from jaxmpc.files.errors import InputError

# wam.md §3.3; between 61 and 67 after libbarrett, which it names as its source
TABLE = [
    ("motor", 150, "VERS 0 ROLE 1 SN 2 ID 3 ERROR 4 STAT 5 ADDR 6 VALUE 7 MODE 8 TEMP 9 PTEMP 10 OTEMP 11 BAUD 12"),
    ("motor", 150, "LOCK 13 DIG0 14 FET0 16 FET1 17 ANA0 18 THERM 20 VBUS 21 IMOTOR 22 VLOGIC 23 ILOGIC 24 SG 25"),
    ("motor", 150, "GRPA 26 GRPB 27 GRPC 28 CMD 29 SAVE 30 LOAD 31 DEF 32 FIND 33 T 42 MT 43 V 44 MV 45 MCV 46 MOV 47"),
    ("motor", 150, "P 48 DP 50 E 52 OT 54 CT 56 M 58 DS 60 MOFST 61 IOFST 62 UPSECS 63 OD 64 MDS 65 MECH 66 CTS 68"),
    ("motor", 150, "PIDX 70 HSG 71 LSG 72 IVEL 73 IOFF 74 MPE 76 HOLD 77 TSTOP 78 KP 79 KD 80 KI 81 ACCEL 82 TENST 83"),
    ("motor", 150, "TENSO 84 JIDX 85 IPNM 86 HALLS 87 HALLH 88 POLES 90 IKP 91 IKI 92 IKCOR 93 EN 94 JP 96 JOFST 98"),
    ("motor", 150, "TIE 100 ECMAX 101 ECMIN 102 LFLAGS 103"),
    ("motor", 118, "P 48 T 42 CTS 68 PIDX 70 IPNM 86 MECH 66 MT 43 GRPB 27 HALLS 87"),
    ("motor", 68, "P 48 T 42 CTS 68 PIDX 70 IPNM 86 KP 79"),
    ("motor", 65, "P 48 T 42 CTS 68 PIDX 70 IPNM 86 KP 79"),
    ("motor", 64, "P 48 T 42 CTS 66 PIDX 68 IPNM 83 KP 76 MECH 64"),
    ("motor", 61, "P 48 T 42 CTS 65 PIDX 67 IPNM 83 KP 76 MECH 63"),
    ("motor", 60, "P 26 T 9 MT 16 CTS 30 IPNM 108 PIDX 54 GRPA 51 GRPB 52 GRPC 53 MECH 28 STAT 5 MODE 8"),
    ("motor", 49, "P 26 T 10"),
    ("safety", 197, "ZERO 42 PEN 43 SAFE 44 VL1 45 VL2 46 TL1 47 TL2 48 VOLTL1 49 VOLTL2 50 VOLTH1 51 VOLTH2 52"),
    ("safety", 61, "PWR 53 MAXPWR 54 IFAULT 55 VNOM 56 DEF 32 LOAD 31 MODE 8 STAT 5"),
    ("safety", 60, "ZERO 55 PEN 85 SAFE 86 VL1 90 VL2 91 TL1 92 TL2 93 IFAULT 100"),
    ("force", 24, "SG1 42 SG6 47 FX 48 TZ 53 FT 54 AX 55 AZ 57 GM 58 OV 59 LED 60 T1 61 T3 63 A 64 STAT 5"),
    ("monitor", 0, "VERS 0 ROLE 1 STAT 5"),
]


@pytest.mark.parametrize(("kind", "version", "text"), TABLE)
def test_numbers_are_those_of_the_tables(kind, version, text):
    words = text.split()
    expected = dict(zip(words[::2], map(int, words[1::2]), strict=True))
    assert {name: number(name, kind, version) for name in expected} == expected


@pytest.mark.parametrize(
    ("name", "kind", "version", "says"),
    [
        ("PIDXX", "motor", 150, "Did you mean 'PIDX'"),
        ("EN", "motor", 118, "one it has"),  # 94 meant something else before version 132
        ("CTS", "safety", 197, "one it has"),
        ("CTS", "monitor", 0, "one it has"),
        ("KD", "motor", 62, "one it has"),
        ("P", "motor", 20, "36 or newer"),
    ],
)
def test_what_a_node_does_not_have_is_refused(name, kind, version, says):
    with pytest.raises(InputError, match=says):
        number(name, kind, version)
