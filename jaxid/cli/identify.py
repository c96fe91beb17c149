"""`jaxid identify`: inverse-dynamics identification of a serial arm from the command line."""

from __future__ import annotations

from pathlib import Path

import click

from jaxid.cli.app import MODEL
from jaxid.cli.options import (
    AS_RECORDED,
    DATASET,
    foretell,
    OUT,
    output_options,
    SECONDS,
    start,
)
from jaxid.cli.output import Output


@click.command()
@DATASET
@OUT
@MODEL
@click.option(
    "--method",
    type=click.Choice(
        ("ls", "wls", "iv", "rls", "tls", "constrained", "paper001", "algorithm1", "algorithm2")
    ),
    default="wls",
    show_default=True,
    metavar="M",
    help=(
        "ls, wls, iv, rls (recursive), tls, constrained (bodies that can exist, friction that"
        " brakes); with --reference paper001, algorithm1, algorithm2: the payload as in paper 001."
    ),
)
@click.option(
    "--friction",
    type=click.Choice(("auto", "linear", "power", "stribeck")),
    default="auto",
    show_default=True,
    metavar="LAW",
    help=(
        "linear, power, stribeck, or auto: the simplest that no richer law beats on every held-out"
        " run."
    ),
)
@click.option(
    "--cutoff",
    type=click.FloatRange(0.01),
    default=5.0,
    show_default=True,
    metavar="HZ",
    help="Low-pass of the torque.",
)
@click.option(
    "--motion-cutoff",
    type=click.FloatRange(0.01),
    metavar="HZ",
    help="Low-pass of positions; default: twice --cutoff.",
)
@click.option(
    "--reference",
    type=click.Path(path_type=Path),
    metavar="UNLOADED/identification.json",
    help="Identification of the unloaded arm: gives the payload.",
)
@click.option(
    "--gain-std",
    type=click.FloatRange(0, 1),
    metavar="S",
    help=(
        "Relative standard deviation of the drive gains, for the payload's interval; default: 0.05"
        " where torques are made of currents, else 0."
    ),
)
@click.option(
    "--motion",
    type=click.Choice(("measured", "commanded", "fourier")),
    default="measured",
    show_default=True,
    metavar="W",
    help=(
        "measured, commanded (the channels q1_cmd … in the place of q1 …), or fourier: the measured"
        " one by its harmonics."
    ),
)
@click.option(
    "--root", metavar="LINK", help="First link of the chain in the URDF that --model names."
)
@SECONDS
@AS_RECORDED
@output_options
def identify(
    dataset,
    out,
    model,
    method,
    friction,
    cutoff,
    motion_cutoff,
    reference,
    gain_std,
    motion,
    root,
    seconds,
    as_recorded,
    as_json,
    quiet,
) -> int:
    """Identify a serial arm: base parameters, friction, payload.

    Writes identification.json and report.html into DIR.
    """
    jaxid, data = start(dataset, out)
    tip = getattr(model, "tip", None)
    if root is not None and (model is None or not model.endswith(".urdf")):
        raise jaxid.UsageError("--root names a link of a URDF: give it as --model arm.urdf")
    if model is not None and model.endswith(".urdf") and (tip is not None or root is not None):
        model = jaxid.models.SerialArm.from_urdf(str(model), tip, root)

    foretell("identify", model, data, quiet)
    from jaxid.report.text import identification_text  # with matplotlib

    with Output(out, as_json, quiet, seconds) as output:
        result = jaxid.identify(
            model,
            data,
            method=method,
            friction=friction,
            cutoff_hz=cutoff,
            motion_hz=motion_cutoff,
            reference=reference,
            gain_std=gain_std,
            as_recorded=as_recorded,
            motion=motion,
            seconds=seconds,
            progress=output.progress,
        )
        return output.deliver(result, identification_text)
