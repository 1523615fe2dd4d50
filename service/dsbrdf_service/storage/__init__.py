"""Store everything that the service keeps on disk; no other subpackage uses the data folder.

`store` rows, files and their life; `uploads` those in progress, and what a key may have; `database`
connections, transactions and the lock; `schema` the tables and their rows; `blobs` the files of measurements;
`removal` their end.
"""
