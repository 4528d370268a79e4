#!/usr/bin/env bash
# rigs.sh FOLDER: make other machines for tests/portability on Debian, and print the variables that name them.
#
# Needs gcc, libc6-dev, musl-dev, npm, python3-pip, and the wheel of ./scripts/swarm wheel in dist.
set -euo pipefail
mkdir -p "$1" && folder=$(realpath "$1")
wheel=$(realpath dist/swarmabs-*.whl)
cd "$folder"

# Python for aarch64: packages of this distribution, unpacked; nothing of them is installed.
mkdir -p aarch64 packages apt/state/lists/partial apt/cache/archives/partial
touch apt/state/status
apt=(-qq -o APT::Architecture=arm64 -o APT::Architectures=arm64 -o APT::Sandbox::User= -o Dir::State="$folder/apt/state"
  -o Dir::State::status="$folder/apt/state/status" -o Dir::Cache="$folder/apt/cache")
apt-get "${apt[@]}" update >&2
series=$(apt-cache "${apt[@]}" depends python3 | grep -om1 'python3\.[0-9]*')
names=("$series" "$series-minimal" "lib$series-stdlib" "lib$series-minimal" libc6 libgcc-s1 libstdc++6 zlib1g libbz2-1.0
  liblzma5 libexpat1 libffi8 libssl3 libsqlite3-0 libuuid1 libreadline8 libtinfo6 libncursesw6 libcrypt1 libdb5.3)
(cd packages && apt-get "${apt[@]}" download "${names[@]}" >&2)
for package in packages/*.deb; do dpkg -x "$package" aarch64; done
platforms=(--platform=manylinux2014_aarch64 --platform=manylinux_2_17_aarch64 --platform=manylinux_2_28_aarch64)
python3 -m pip download --quiet --dest aarch64/wheels --only-binary=:all: "${platforms[@]}" \
  --python-version="${series#python}" "$wheel" >&2
rm aarch64/wheels/swarmabs-*.whl # the tests build the wheel that they install

# The mathematical functions of musl, which round other results wrongly than those of glibc.
functions=(sin cos tan asin acos atan atan2 sinh cosh tanh exp exp2 expm1 log log2 log10 log1p pow)
echo "{ global: $(printf '%s; ' "${functions[@]}") local: *; };" >exported.map
gcc -shared -nostartfiles -Wl,--version-script=exported.map "${functions[@]/#/-Wl,-u,}" -o libm-musl.so \
  -lc "/usr/lib/$(uname -m)-linux-musl/libc.a"

# CPython as WebAssembly.
npm install --silent --no-save --prefix "$folder" pyodide >&2

echo "export SWARMABS_AARCH64_ROOT=$folder/aarch64"
echo "export SWARMABS_LIBM=$folder/libm-musl.so"
echo "export SWARMABS_PYODIDE=$folder/node_modules/pyodide"
