"""Store everything that the service keeps on disk; no other subpackage uses the data folder.

`store` has the rows of fits and measurements, and `atlas` the fits that come with the library; `keys` has the API keys;
`files` has the files of measurements, unfinished files and the quotas; `database` has connections, transactions and the
lock; `schema` defines the tables and their rows; `maintenance` deletes rows and files, and finds damage; `health`
counts rows and bytes, and checks that the folder can be used.
"""
