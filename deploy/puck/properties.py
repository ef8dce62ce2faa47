"""Numbers of the properties, which depend on the kind of node and on its firmware (wam.md §3.3).

The bounds between generations of motor firmware are those of libbarrett: numbers change with versions 64 and 65,
so 65 to 67 already have the newest ones.
"""

from collections.abc import Mapping, Sequence
from typing import Final, Literal

from jaxmpc.files.errors import InputError, nearest

Kind = Literal["motor", "safety", "force", "monitor"]

STAT_RESET, STAT_ERROR, STAT_READY = 0, 1, 2
"""Values of STAT."""
MODE_IDLE, MODE_TORQUE = 0, 2
"""Values of a motor puck's MODE."""
SAFETY_E_STOP, SAFETY_IDLE, SAFETY_ACTIVE = 0, 1, 2
"""Values of the safety module's MODE."""
ROLES: Final = ("motor", "gimbals", "safety", "wraptor", "trigger", "hand", "force")
"""By the low 5 bits of ROLE."""
ROLE_ABSOLUTE_ENCODER: Final = 0x0100


def _numbered(names: str, first: int) -> dict[str, int]:
    """Consecutive numbers; a dot stands for one that is skipped."""
    return {name: first + i for i, name in enumerate(names.split()) if name != "."}


_EVERYWHERE: Final = _numbered("VERS ROLE SN ID ERROR STAT ADDR VALUE MODE", 0)
VERS, ROLE, STAT, MODE = (_EVERYWHERE[name] for name in ("VERS", "ROLE", "STAT", "MODE"))
"""Numbers that are the same in every firmware."""
_COMMON: Final = {
    **_EVERYWHERE,
    **_numbered("TEMP PTEMP OTEMP BAUD LOCK DIG0 DIG1 FET0 FET1 ANA0 ANA1 THERM VBUS IMOTOR VLOGIC ILOGIC SG", 9),
    **_numbered("GRPA GRPB GRPC CMD SAVE LOAD DEF FIND", 26),
}
_MOTOR_CORE: Final = _COMMON | _numbered("T MT V MV MCV MOV P . DP . E . OT . CT", 42)
_MOTOR_64: Final = _MOTOR_CORE | {"MECH": 64, "CTS": 66, "PIDX": 68, "KP": 76, "IPNM": 83}
_MOTOR_61: Final = _MOTOR_CORE | {"MECH": 63, "CTS": 65, "PIDX": 67, "KP": 76, "IPNM": 83}
_MOTOR_65: Final = {
    **_MOTOR_CORE,
    **_numbered("M . DS MOFST IOFST UPSECS OD MDS MECH . CTS . PIDX HSG LSG IVEL IOFF . MPE HOLD TSTOP", 58),
    **_numbered("KP KD KI ACCEL TENST TENSO JIDX IPNM", 79),
}
_MOTOR_68: Final = _MOTOR_65 | _numbered("HALLS HALLH . POLES IKP IKI IKCOR", 87)
_MOTOR_132: Final = _MOTOR_68 | _numbered("EN . JP . JOFST . TIE ECMAX ECMIN LFLAGS", 94)
_OLD: Final = _EVERYWHERE | {"GRPA": 51, "GRPB": 52, "GRPC": 53, "SAVE": 87, "LOAD": 88, "DEF": 89}
_MOTOR_36: Final = _OLD | {"T": 10, "MT": 16, "P": 26, "MECH": 28, "CTS": 30, "PIDX": 54, "IPNM": 108}
_SAFETY_36: Final = {
    **_OLD,
    **{"ZERO": 55, "PEN": 85, "SAFE": 86, "VL1": 90, "VL2": 91, "TL1": 92, "TL2": 93, "IFAULT": 100},
}
_SAFETY_61: Final = _COMMON | _numbered(
    "ZERO PEN SAFE VL1 VL2 TL1 TL2 VOLTL1 VOLTL2 VOLTH1 VOLTH2 PWR MAXPWR IFAULT VNOM", 42
)
_FORCE: Final = {
    **_COMMON,
    **_numbered("SG1 SG2 SG3 SG4 SG5 SG6 FX FY FZ TX TY TZ FT AX AY AZ GM OV LED T1 T2 T3 A", 42),
}
_TABLES: Final[Mapping[Kind, Sequence[tuple[int, Mapping[str, int]]]]] = {
    "motor": (
        (132, _MOTOR_132),
        (68, _MOTOR_68),
        (65, _MOTOR_65),
        (64, _MOTOR_64),
        (61, _MOTOR_61),
        (50, _MOTOR_36 | {"T": 9}),
        (36, _MOTOR_36),
    ),
    "safety": ((61, _SAFETY_61), (36, _SAFETY_36)),
    "force": ((0, _FORCE),),
    # what a puck runs before it is woken, when only these can be relied on
    "monitor": ((0, {name: _EVERYWHERE[name] for name in ("VERS", "ROLE", "STAT")}),),
}


def number(name: str, kind: Kind, version: int) -> int:
    """The number that a node knows a property by.

    Args:
        name: Barrett's name, as VERS, P, CTS.
        kind: Motor puck, safety module, force sensor, or any of them in its monitor, before it is woken.
        version: Of its firmware, as VERS says.

    Raises:
        InputError: Firmware so old that no numbers are known, or a property that it does not have.
    """
    for since, table in _TABLES[kind]:
        if version >= since:
            if name not in table:
                raise InputError(f"property of {kind} firmware {version}", name, "one it has", nearest(name, [*table]))
            return table[name]
    oldest = _TABLES[kind][-1][0]
    raise InputError(f"{kind} firmware", version, f"{oldest} or newer", "Have Barrett update it.")
