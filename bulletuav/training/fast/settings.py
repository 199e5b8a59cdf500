"""Settings of the algorithm `fast_ppo`, and their checks."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from bulletuav.errors import as_int, as_sequence, find_choice, finite, shown, suggest_names
from bulletuav.policies.run import DEFAULTS, FAST, RunConfig, whole_number
from bulletuav.training.fast.ppo import Losses

REMEDY = "choose --algo ppo"
"""Remedy for what only stable-baselines3 supports"""
FEATURES: dict[str | None, tuple[str, ...]] = {
    None: (),
    "symlog": ("scale",),
    "swarm": ("scale", "size"),
}
"""Values of the setting `features`, each with the names in its `features_extractor_kwargs`"""
CRITICS = ("own", "state")
"""Values of the setting `critic`: inputs are the features alone, or also the global state"""
POLICY_SETTINGS = ("net_arch", "log_std_init", "features_extractor_kwargs")
"""Names in the setting `policy_kwargs`"""
FEATURE_SIZE = 32
"""Default number of outputs of the network of each entity"""
MAX_COUNT = 10**9
"""Maximum of integer settings"""
MAX_WIDTH = 4096
"""Maximum width of a layer"""
MAX_LAYERS = 100
"""Maximum number of layers of a network"""


class FastSettings(NamedTuple):
    """Checked settings of the algorithm; names are those of stable-baselines3's PPO."""

    n_steps: int
    batch_size: int
    n_epochs: int
    learning_rate: tuple[float, float]
    gamma: float
    gae_lambda: float
    losses: Losses
    actor: tuple[int, ...]
    critic: tuple[int, ...]
    is_central: bool
    log_std: float
    features: str | None
    scale: float
    size: int


def check_fast_settings(config: RunConfig) -> FastSettings:
    """Check the settings of the algorithm.

    Args:
        config: Settings of the run.

    Raises:
        ValueError: If a setting is unknown or invalid.
    """
    model = config.settings
    _require_known("", model, (*DEFAULTS[FAST], "features"))
    features = model["features"]
    if features is not None:
        named = dict.fromkeys(name for name in FEATURES if name is not None)
        try:
            find_choice("features", features, named)
        except ValueError as error:
            raise ValueError(f"{FAST}: {error}; {REMEDY} for others") from None
    central = find_choice("critic", model["critic"], {name: name for name in CRITICS})
    policy = _mapping("policy_kwargs", model["policy_kwargs"])
    _require_known("policy_kwargs: ", policy, POLICY_SETTINGS)
    extractor = _mapping("features_extractor_kwargs", policy.get("features_extractor_kwargs", {}))
    _require_known("features_extractor_kwargs: ", extractor, FEATURES[features])
    widths = policy.get("net_arch", [64, 64])
    both = widths if isinstance(widths, Mapping) else {"pi": widths, "vf": widths}
    _require_known("net_arch: ", both, ("pi", "vf"))
    actor, critic = (
        tuple(
            as_int("net_arch", width, 1, MAX_WIDTH)
            for width in as_sequence("net_arch", both.get(name, ()), most=MAX_LAYERS)
        )
        for name in ("pi", "vf")
    )
    rate = model["learning_rate"]
    first, last = rate if isinstance(rate, list | tuple) and len(rate) == 2 else (rate, rate)
    n_steps, batch_size, n_epochs = (
        as_int(name, whole_number(model[name]), 1, MAX_COUNT)
        for name in ("n_steps", "batch_size", "n_epochs")
    )
    clip, entropy, value, max_norm = (
        finite(name, model[name], 0.0)
        for name in ("clip_range", "ent_coef", "vf_coef", "max_grad_norm")
    )
    return FastSettings(
        n_steps,
        batch_size,
        n_epochs,
        learning_rate=(finite("learning_rate", first, 0.0), finite("learning_rate", last, 0.0)),
        gamma=finite("gamma", model["gamma"], 0.0, 1.0),
        gae_lambda=finite("gae_lambda", model["gae_lambda"], 0.0, 1.0),
        losses=Losses(clip, entropy, value, max_norm),
        actor=actor,
        critic=critic,
        is_central=central == CRITICS[1],
        log_std=finite("log_std_init", policy.get("log_std_init", 0.0), -20.0, 2.0),
        features=features,
        scale=finite("scale", extractor.get("scale", 1.0), 1e-6, 1e6) if features else 0.0,
        size=as_int("size", extractor.get("size", FEATURE_SIZE), 1, MAX_WIDTH),
    )


def _require_known(where: str, given: Mapping[str, Any], known: tuple[str, ...]) -> None:
    """Raise ValueError for a name that the algorithm does not have."""
    for name in given:
        if name not in known:
            hint = suggest_names(name, known) if known else "leave it out"
            raise ValueError(
                f"{where}{FAST} has no setting {shown(name)}: {hint}; for all settings of "
                f"stable-baselines3 {REMEDY}"
            )


def _mapping(name: str, value: Any) -> Mapping[str, Any]:
    """Return a mapping of settings; raise ValueError for other values."""
    if not isinstance(value, Mapping):
        raise ValueError(f"{name} is {shown(value)}: names with values are needed")
    return value
