"""Networks and hit models that the package ships, chosen for the sensors and the site."""

from collections.abc import Iterable

from models.config import SHIPPED
from placement_env.fidelity.hit_model import HitModel, find_hit_model, load_models, shipped_model
from placement_env.setting import Setting
from toolkit.detection.background import add_background
from toolkit.detection.scheme import surrogate_name
from toolkit.detection.schemes import SCHEMES
from toolkit.objects import Detector
from toolkit.sensors.sensor import Sensor
from toolkit.sites.files import format_site
from toolkit.sites.site import Site

GENERAL = "general"  # name of the network not trained at any site
MAX_KEPT_DETECTORS = 4  # shipped detectors held in memory, each for one site
# shipped detectors by name of the network and text of the site's file, oldest first
_DETECTORS: dict[tuple[str, str], Detector] = {}


def surrogate_models(setting: Setting, iou: float, network: str) -> tuple[HitModel, ...]:
    """Hit model of each class that counts, from the setting's file or the shipped ones.

    Args:
        setting: Setting with the fusion scheme, the classes, and the path of a file of hit
            models (None for the shipped ones).
        iou: IoU threshold of vehicles; `Classes.get_iou` gives the ones for other classes.
        network: Name of the network whose shipped models are taken.

    Raises ValueError for a missing model, FileNotFoundError for a missing file."""
    classes = setting.counted
    scheme = setting.fusion
    path = setting.surrogate
    # the class's name and IoU threshold of each model
    model_keys = [(name, classes.get_iou(name, iou)) for name in classes.names]
    if path is None:
        return tuple(
            shipped_model(surrogate_name(scheme), threshold, network, label=name)
            for name, threshold in model_keys
        )
    models = load_models(path, schemes=(*SCHEMES, scheme.name))
    return tuple(
        find_hit_model(models, surrogate_name(scheme), threshold, name, source=str(path))
        for name, threshold in model_keys
    )


def load_shipped_detector(network: str, site: Site) -> Detector:
    """Load a shipped network as the detector at a site, once for all preparations.

    The general network was not trained there and would take a hedge for a vehicle in every frame,
    so it gets the empty site as background. The last `MAX_KEPT_DETECTORS` loaded are kept.

    network: Name of the network, from `find_network`."""
    from models.detector_loading import load_detector

    key = network, format_site(site)
    if key not in _DETECTORS:
        detector = load_detector(network, area=site.area)
        _DETECTORS[key] = add_background(detector, site) if network == GENERAL else detector
        if len(_DETECTORS) > MAX_KEPT_DETECTORS:
            del _DETECTORS[next(iter(_DETECTORS))]  # the oldest
    return _DETECTORS[key]


def find_network(site: Site, sensors: Iterable[Sensor]) -> str:
    """Name of the shipped network for some sensors at a site.

    It is the site's name, for a network trained there, if the site has all these sensors; else
    `GENERAL`."""
    is_trained_here = (
        set(sensors) <= set(site.sensors) and (SHIPPED / f"{site.name}.safetensors").exists()
    )
    return site.name if is_trained_here else GENERAL
