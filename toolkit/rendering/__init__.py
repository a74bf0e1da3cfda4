"""Ray casting: the static scene, moving bodies, silhouettes. The only ray caster of the house."""
