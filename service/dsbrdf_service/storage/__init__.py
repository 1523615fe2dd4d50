"""Store everything that the service keeps on disk; no other subpackage uses the data folder.

`store` has the rows of fits and measurements, `keys` those of API keys; `writing` has the files in progress and the
quotas; `database` has connections, transactions and the lock; `schema` defines the tables and their rows; `blobs` has
the files of measurements, `removal` deletes them, and `inspection` looks for damage.
"""
