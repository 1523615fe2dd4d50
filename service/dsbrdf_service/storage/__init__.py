"""Store everything that the service keeps on disk; no other subpackage uses the data folder.

`store` has the rows of fits and measurements; `keys` has the rows of API keys; `writing` has unfinished files and the
quotas; `database` has connections, transactions and the lock; `schema` defines the tables and their rows; `blobs` has
the files of measurements; `removal` deletes rows and files; `inspection` finds damage.
"""
