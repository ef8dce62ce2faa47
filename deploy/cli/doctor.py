"""`jaxmpc doctor`: may this machine run the robot, and if not, what to do about it. Works with numpy and python-can."""

import argparse
from pathlib import Path

from deploy.cli.run_arguments import A_NETWORK, ONE_PROGRAM
from jaxmpc.files.errors import InputError


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    from deploy.bus.interface import add_arguments

    parser.add_argument("--artifact", type=Path, help="a frozen controller that is to run")
    parser.add_argument("--rate", type=float, help="cycles [Hz] (the controller's, else 1000)")
    parser.add_argument("--joints", type=int, choices=(4, 7), default=4, help="of the arm (4)")
    parser.add_argument("--sensor", choices=("can", "jr3", "none"), default="can", help="of the force (can)")
    add_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Look at everything and print it; 1 if something prevents a run.

    Raises:
        InputError: The rate is none, or the flags of the bus name none of an arm.
    """
    from deploy import doctor
    from deploy.bus.interface import check_flags, check_given

    if args.rate is not None and not 1.0 <= args.rate <= 10_000.0:
        raise InputError("--rate", args.rate, "in [1, 10000] Hz", "The paper's controller runs at 1000.")
    named = "channel" in args or "interface" in args
    (check_flags if named else check_given)(args)
    findings = doctor.versions()
    rate, limits = args.rate, None
    if args.artifact:
        finding, artifact = doctor.controller(args.artifact)
        findings.append(finding)
        if artifact is not None:
            law, limits = 1.0 / artifact.T_s, artifact.arm.limits if artifact.arm is not None else None
            if rate is not None and abs(rate / law - 1.0) > 1e-9:
                text = f"rate: the controller's law runs at {law:g} Hz, not {rate:g}: freeze another one"
                findings.append(doctor.Finding("wrong", text))
            rate = rate or law
    rate = rate or 1000.0
    findings += doctor.machine(rate)
    findings.append(doctor.jr3(args.sensor == "jr3"))
    lines, finding = doctor.budget(args.joints, args.sensor == "can", rate)
    findings.append(finding)
    if named:
        findings += doctor.bus(args, args.sensor == "can", limits)
        if getattr(args, "interface", None) in ONE_PROGRAM:
            text = f"bus: `run` refuses {args.interface}, which its watchdog cannot open, too: {A_NETWORK}"
            findings.append(doctor.Finding("wrong", text))
    else:
        findings.append(doctor.Finding("note", "bus: not looked at; name it by --interface and --channel"))

    for level, text in findings:
        print(f"{level:<6}{text}")
    print("\n" + "\n".join(lines))
    wrong = sum(level == "wrong" for level, _ in findings)
    print("\n" + (f"{wrong} to be put right before a run" if wrong else "nothing prevents a run"))
    return 1 if wrong else 0
