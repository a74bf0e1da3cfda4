"""Ray casting: static scene, moving bodies, silhouettes."""
