"""Readers and writers of motion files: BVH, ASF + AMC and SMPL npz."""
