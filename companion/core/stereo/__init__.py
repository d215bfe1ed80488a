"""Stereo geometry that moves: rotations, extrinsics at exposure, matching, range, sigma, sectors."""
