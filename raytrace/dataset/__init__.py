"""Datasets on disk: made shard by shard, resumed, merged, checked and exported."""
