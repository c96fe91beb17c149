"""`jaxid identify`: inverse-dynamics identification of a serial arm from the command line."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from jaxid.cli.app import AS_RECORDED, DATASET, foretell, MODEL, OUT, output_options, start
from jaxid.cli.output import Output


if TYPE_CHECKING:
    from jaxid.identification.run import Identification


@click.command()
@DATASET
@OUT
@MODEL
@click.option(
    "--method", type=click.Choice(("ls", "wls", "iv", "rls", "tls", "constrained")), default="wls", show_default=True,
    metavar="M",
    help="ls, wls, iv, rls (recursive), tls or constrained (bodies that can exist, friction that brakes).",
)  # fmt: skip
@click.option(
    "--friction", type=click.Choice(("auto", "linear", "power", "stribeck")), default="auto", show_default=True, metavar="LAW",
    help="linear, power, stribeck, or auto: the simplest that no richer law beats on every held-out run.",
)  # fmt: skip
@click.option(
    "--cutoff", type=click.FloatRange(0.01), default=5.0, show_default=True, metavar="HZ", help="Low-pass of the torque."
)
@click.option(
    "--motion-cutoff", type=click.FloatRange(0.01), metavar="HZ", help="Low-pass of positions; default: twice --cutoff."
)
@click.option(
    "--reference", type=click.Path(path_type=Path), metavar="UNLOADED/identification.json",
    help="Identification of the unloaded arm: gives the payload.",
)  # fmt: skip
@click.option(
    "--gain-std", type=click.FloatRange(0, 1), default=0.0, show_default=True, metavar="S",
    help="Relative standard deviation of the drive gains, for the payload's interval.",
)  # fmt: skip
@click.option("--tip", metavar="LINK", help="Last link of the chain in the URDF that --model names.")
@click.option("--root", metavar="LINK", help="First link of the chain in the URDF that --model names.")
@AS_RECORDED
@output_options
def identify(
    dataset, out, model, method, friction, cutoff, motion_cutoff, reference, gain_std, tip, root, as_recorded, as_json, quiet
) -> int:
    """Identify a serial arm: base parameters, friction, payload.

    Writes identification.json and report.html into DIR.
    """
    jaxid, data = start(dataset, out)
    if tip is not None or root is not None:
        if model is None or not model.endswith(".urdf"):
            raise jaxid.UsageError("--tip and --root name links of a URDF: give it as --model arm.urdf")
        model = jaxid.models.SerialArm.from_urdf(model, tip, root)

    foretell("identify", model, data, quiet)
    with Output(out, as_json, quiet) as output:
        result = jaxid.identify(
            model, data, method=method, friction=friction, cutoff_hz=cutoff, motion_hz=motion_cutoff, reference=reference,
            gain_std=gain_std, as_recorded=as_recorded,
        )  # fmt: skip
        return output.deliver(result, identification_text)


def identification_text(result: Identification) -> str:
    """The result as tables for a terminal."""
    from jaxid.conventions.finding import data_lines
    from jaxid.report.identified import base_rows, friction_rows, headline, payload_rows
    from jaxid.report.text import table

    joints = result.labels
    parts = [
        *data_lines(result.data),
        f"{result.dataset}, model {result.model}: {result.method}, friction law {result.law}. {headline(result)}",
        table(
            ("recording", "data", "all joints", *joints, "unfiltered"),
            [
                (
                    e.file, e.split, f"{100 * e.relative_error:.2f} %", *(f"{100 * r:.1f} %" for r in e.relative_error_per_joint),
                    f"{100 * e.unfiltered_relative_error:.2f} %",
                )
                for e in result.experiments
            ],
        ),
        table(("friction", *joints), [(f"{name} ({unit})", *values) for name, unit, values in friction_rows(result)]),
        table(("base parameter", "value", "unit", "stands for", ""), base_rows(result)),
    ]  # fmt: skip
    if result.payload is not None:
        parts.append(table(("payload", "value", "95 % interval"), payload_rows(result)))
    parts.append(
        f"condition number {result.condition_number:.4g} ({result.condition_number_scaled:.4g} with columns of equal length)"
    )
    parts += [f"note: {n}" for n in (result.filter, *result.notes)]
    return "\n".join(parts)
