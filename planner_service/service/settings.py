"""Settings of the planner service: `--name`, or MOTIONLOOP_PLANNER_NAME in the environment."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field
from pydantic_settings import SettingsConfigDict

from shared.settings import Names, ServiceSettings

DEFAULT_LIBRARY = Path(__file__).resolve().parent.parent / "weights" / "clips"
RISE_LIBRARY = Path(__file__).resolve().parent.parent / "weights" / "rises"


class PlannerSettings(ServiceSettings):
    """What the planner service can be told, beside `ServiceSettings`."""

    model_config = SettingsConfigDict(env_prefix="MOTIONLOOP_PLANNER_")

    endpoint: Annotated[str, Field(description="where to listen")] = "tcp://127.0.0.1:5601"
    plugins: Annotated[Names | None, Field(description="plug-ins to offer, with commas; default: all that load")] = None
    default_plugin: Annotated[
        str | None, Field(description="for requests that name none; default: dip, else clip, else stand")
    ] = None
    clip_library: Annotated[Path, Field(description="folder of recorded motion for `clip`")] = DEFAULT_LIBRARY
    rise_library: Annotated[Path, Field(description="folder of get-ups for `rise`")] = RISE_LIBRARY
    dip_weights: Annotated[Path | None, Field(description="weights of `dip`; default: the shipped ones")] = None
    runtime: Annotated[
        Literal["auto", "torch", "openvino"],
        Field(description="what runs the network of `dip`; auto: openvino where it is installed, else torch"),
    ] = "auto"
    steps: Annotated[
        int | None,
        Field(ge=1, description="diffusion steps of `dip`; default: all with bfloat16, half on processors without"),
    ] = None
    threads: Annotated[int, Field(ge=1, le=256, description="CPU threads of the network")] = 1
    max_batch: Annotated[int, Field(ge=1, le=256, description="characters planned for at once")] = 8
    max_wait_ms: Annotated[float, Field(ge=0, le=1000, description="wait for others to fill a batch")] = 4.0
