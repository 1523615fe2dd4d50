#!/usr/bin/env bash
# Prove the files of this folder where no Docker runs: make a fresh Debian root, build the Dockerfile on it, run both
# compose files as they are, and look whether they do what they promise.
#
# Wants root on a Debian machine, 3 GB in the temporary folder, Debian's and Python's package registries, and
#     apt-get install --no-install-recommends debootstrap podman runc netavark aardvark-dns iptables catatonit curl iproute2 openssl
# Podman builds and runs; all that it makes is in one temporary folder and in namespaces that end with the script, so the
# ports, networks and containers of this machine are not touched.
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)

main() {
  [ "$(id -u)" = 0 ] || fail "this needs root, for debootstrap and for namespaces"
  for tool in debootstrap podman runc catatonit curl ip openssl unshare python3; do
    command -v "$tool" >/dev/null || fail "$tool is not installed; the head of this file names the packages"
  done
  scratch=$(mktemp --directory --tmpdir dsbrdf-proof.XXXXXX)
  trap 'rm --recursive --force --one-file-system "$scratch"' EXIT
  inside --mount -- build
  inside --mount --net -- run
  echo "Everything holds, after $SECONDS s."
}

# Do a part of this script in namespaces of its own: what is mounted or still running there is gone when it returns.
inside() {
  unshare "${@:1:$#-2}" --pid --fork --kill-child --mount-proc "$here/prove.sh" "${@: -1}" "$scratch"
}

fail() {
  printf 'prove.sh: %s\n' "$*" >&2
  exit 1
}

# Say what a command is to show, and end if it does not: `holds WHAT COMMAND`, `fails WHAT COMMAND`.
holds() {
  local begin=$SECONDS
  "${@:2}" >"$scratch/out" 2>&1 || { tail -40 "$scratch/out" >&2; fail "not so: $1"; }
  printf '%4d s  %s\n' $((SECONDS - begin)) "$1"
}
fails() {
  holds "$1" refused "${@:2}"
}
refused() {
  ! "$@"
}

build() {
  local base=docker.io/library/debian:trixie-slim # what the Dockerfile asks for
  holds "a fresh Debian root" debootstrap --variant=minbase trixie "$scratch/root"
  chroot "$scratch/root" apt-get clean
  tar --directory "$scratch/root" --create . | podman import --quiet - "$base" >/dev/null
  # pip and uv reach their index as pip does on this machine.
  printf '[global]\ncert = /etc/ssl/certs/ca-certificates.crt\n' >"$scratch/pip.conf"
  printf 'system-certs = true\n' >"$scratch/uv.toml"
  if index=$(python3 -m pip config get global.index-url 2>/dev/null); then
    echo "index-url = $index" >>"$scratch/pip.conf"
    printf '[[index]]\nurl = "%s"\ndefault = true\n' "$index" >>"$scratch/uv.toml"
  fi
  for target in service proxy; do
    holds "the image of the $target builds" podman build --isolation chroot --format docker --layers=false --pull=never \
      --volume "$scratch/pip.conf:/etc/pip.conf:ro" --volume "$scratch/uv.toml:/etc/uv/uv.toml:ro" \
      --volume /etc/ssl/certs/ca-certificates.crt:/etc/ssl/certs/ca-certificates.crt:ro \
      --ignorefile "$here/Dockerfile.dockerignore" --file "$here/Dockerfile" --target "$target" \
      --tag "dsbrdf-$target" "$here/.."
  done
  podman tag dsbrdf-service dsbrdf
  podman images --format '{{.Repository}} {{.Size}}' --filter reference=dsbrdf
  python3 -m venv "$scratch/tools"
  holds "podman-compose is installed" "$scratch/tools/bin/pip" install podman-compose==1.6.0
}

run() {
  mount -t tmpfs tmpfs /run
  ip link set lo up
  beat &
  service_alone
  cluster
}

# Podman leaves it to systemd to run health checks; here this does.
beat() {
  while sleep 2; do
    for container in $(podman ps --quiet); do
      podman healthcheck run "$container" || true
    done
  done >/dev/null 2>&1
}

service_alone() {
  echo "compose.yaml"
  files=("$here/compose.yaml") url=http://127.0.0.1:8000
  fails "without a key it does not start" compose run --rm service
  grep --quiet "API key" "$scratch/out" || fail "it does not say why: $(tail -3 "$scratch/out")"
  add_key
  compose up --detach --no-build >/dev/null 2>&1
  holds "it becomes ready" eventually ask "$url/health/ready"
  local name
  name=$(podman ps --format '{{.Names}}')
  holds "the image's health check passes" podman healthcheck run "$name"
  holds "it runs as user 10001" sh -c "[ \$(podman exec $name id --user) = 10001 ]"
  holds "the doctor finds nothing wrong" podman exec "$name" dsbrdf doctor
  holds "it has no capabilities" podman exec "$name" grep --quiet 'CapBnd:.0000000000000000' /proc/1/status
  for place in / /etc /opt/dsbrdf /usr/lib /var/lib; do
    fails "it cannot write to $place" podman exec "$name" touch "$place/x"
  done
  for place in /data /tmp; do
    holds "it can write to $place" podman exec "$name" touch "$place/x"
  done
  for module in pip uv pytest mypy hatchling httpx; do
    fails "$module is not in the image" podman exec "$name" /opt/dsbrdf/bin/python3 -c "import $module"
  done
  podman exec "$name" /opt/dsbrdf/bin/python3 -c 'import dsbrdf; from dsbrdf.data.synthetic import synthetic_measurement
dsbrdf.write_merl("/data/paint.binary", synthetic_measurement(noise=0.02))'
  podman cp "$name:/data/paint.binary" "$scratch/paint.binary"
  fit_succeeds
  local begin=$SECONDS
  holds "it stops at SIGTERM" podman stop --time 20 "$name"
  [ $((SECONDS - begin)) -le 10 ] || fail "stopping took $((SECONDS - begin)) s"
  [ "$(podman inspect --format '{{.State.ExitCode}}' "$name")" = 0 ] || fail "it did not end with exit code 0"
  podman start "$name" >/dev/null
  holds "it is ready again" eventually ask "$url/health/ready"
  holds "the fit is still there" grep --quiet '"status":"succeeded"' <(ask "$url/v1/fits")
  compose down --volumes >/dev/null 2>&1
}

cluster() {
  echo "compose.cluster.yaml"
  cp --recursive "$here" "$scratch/docker" # where the certificate can be put
  files=("$scratch/docker/compose.cluster.yaml") url=http://127.0.0.1:8080
  add_key --no-deps
  compose up --detach --no-build >/dev/null 2>&1
  holds "it becomes ready, through nginx" eventually ask "$url/health/ready"
  fit_succeeds
  fails "the scheduler is not published" bash -c '</dev/tcp/127.0.0.1/8786'
  holds "the service reaches the scheduler" podman exec dsbrdf-cluster_service_1 bash -c '</dev/tcp/scheduler/8786'
  fails "nginx does not" podman exec dsbrdf-cluster_proxy_1 timeout 3 bash -c '</dev/tcp/scheduler/8786'
  fails "the scheduler's page is for itself" podman exec dsbrdf-cluster_service_1 bash -c '</dev/tcp/scheduler/8787'
  holds "nginx refuses a body that is too long" sh -c "head --bytes=40000000 /dev/zero \
    | curl --silent --data-binary @- '$url/v1/measurements' | grep --quiet urn:dsbrdf:problem:too-large"
  crash dsbrdf-cluster_worker_1
  holds "a fit succeeds after a worker has died" fit 4
  for name in scheduler_1 worker_1 worker_2 service_1 proxy_1; do
    holds "healthy: $name" eventually podman healthcheck run "dsbrdf-cluster_$name"
  done
  compose down >/dev/null 2>&1
  tls
  compose down --volumes >/dev/null 2>&1
}

tls() {
  local folder=$scratch/docker/tls
  openssl req -x509 -newkey rsa:2048 -nodes -days 2 -subj /CN=localhost -addext subjectAltName=DNS:localhost \
    -keyout "$folder/key.pem" -out "$folder/fullchain.pem" 2>/dev/null
  chown 33 "$folder/key.pem"
  files+=("$scratch/docker/compose.tls.yaml") url=https://localhost:8443
  compose up --detach --no-build >/dev/null 2>&1
  export CURL_CA_BUNDLE=$folder/fullchain.pem
  holds "it becomes ready, over TLS" eventually ask "$url/health/ready"
  holds "the fits are still there" grep --quiet '"status":"succeeded"' <(ask "$url/v1/fits")
  unset CURL_CA_BUNDLE
  fails "who does not trust the certificate gets nothing" ask "$url/health/ready"
}

# Kill what a container runs, as a crash would; a `podman kill` would be taken for the operator's wish.
crash() {
  podman exec "$1" /opt/dsbrdf/bin/python3 -c 'import os, pathlib, signal
for folder in pathlib.Path("/proc").glob("[0-9]*"):
    if b"dask" in (folder / "cmdline").read_bytes() and int(folder.name) not in (1, os.getpid()):
        os.kill(int(folder.name), signal.SIGKILL)'
}

add_key() {
  key=$(compose run --rm "$@" service keys add proof 2>/dev/null | grep --only-matching '^dsbrdf_[A-Za-z0-9_-]*')
}

fit_succeeds() {
  fails "a request without a key is refused" curl --silent --fail "$url/v1/fits"
  holds "a fit with the default options succeeds" fit auto
}

fit() {
  curl --silent --max-time 300 --header "Authorization: Bearer $key" --header 'Prefer: wait=250' \
    --header 'Content-Type: application/octet-stream' --data-binary "@$scratch/paint.binary" "$url/v1/fits?n_lobes=$1" \
    | tee /dev/stderr | grep --quiet '"status":"succeeded"'
}

ask() {
  curl --silent --fail --max-time 10 --header "Authorization: Bearer $key" "$1"
}

eventually() {
  for _ in $(seq 120); do
    ! "$@" || return 0
    sleep 1
  done
  podman ps --all
  compose logs
  return 1
}

compose() {
  timeout 120 "$scratch/tools/bin/podman-compose" "${files[@]/#/--file=}" "$@"
}

configure_podman() {
  cat >"$scratch/storage.conf" <<END
[storage]
driver = "overlay"
graphroot = "$scratch/images"
runroot = "$scratch/running"
END
  cat >"$scratch/containers.conf" <<END
[containers]
default_ulimits = ["nofile=4096:4096", "nproc=4096:4096"]
log_driver = "k8s-file"
[engine]
runtime = "runc"
cgroup_manager = "cgroupfs"
events_logger = "file"
tmp_dir = "$scratch/libpod"
[network]
network_backend = "netavark"
network_config_dir = "$scratch/networks"
END
  export CONTAINERS_STORAGE_CONF=$scratch/storage.conf CONTAINERS_CONF=$scratch/containers.conf
}

if [ $# -eq 0 ]; then
  main
else
  scratch=$2
  configure_podman
  "$1"
fi
