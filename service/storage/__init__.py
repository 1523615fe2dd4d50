"""What the service keeps on disk; no other wing touches the data folder.

`store` rows, files and their life; `uploads` files that are being received, and what a key may have; `database`
connections, transactions and the lock; `schema` the tables and their rows; `blobs` the files of measurements.
"""
