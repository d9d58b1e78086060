"""Material laws of the gel: `LAWS` names them, one law a file, all behind the interface of `law.Law`."""

from simgen.fem.material.neo_hookean import NeoHookean
from simgen.fem.material.yeoh import Yeoh

LAWS = {law.name: law for law in (NeoHookean, Yeoh)}
