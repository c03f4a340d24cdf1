#!/usr/bin/env bash
# Stage-1 epochs beside PyTorch, in one sitting on one machine: ratio of seconds at equal threads, batches and sizes.
#
#   benches/torch.sh path/to/flare_stage1_torch.py [eager|full]
#
# The argument is any script that trains one epoch of the published stage-1 loss and takes the options used below, printing
# a JSON line with `wall_min` and `user_min`. PyTorch is installed from PyPI into target/torch-bench when absent. `full` compiles the whole
# loss first, which takes minutes.
set -euo pipefail
script=${1:?usage: benches/torch.sh path/to/flare_stage1_torch.py [eager|full]}
mode=${2:-eager}
cd "$(dirname "$0")/.."

python=target/torch-bench/bin/python
if ! "$python" -c 'import torch' 2>/dev/null; then
    python3 -m venv target/torch-bench
    "$python" -m pip install --quiet --disable-pip-version-check torch numpy
fi
cargo build --quiet --release --bench flare

bench() { cargo bench --quiet --bench flare -- --json; }
torch() { # channels sequences latent batch threads
    local compile=none
    [[ $mode == full ]] && compile=full
    "$python" "$script" --channels "$1" --seqs "$2" --r "$3" --batch "$4" --threads "$5" --compile "$compile" |
        grep -o '{.*}' | tail -1
}

# One after the other: what runs at the same time would share the cores.
lines=$(bench)
while read -r line; do
    field() { "$python" -c 'import json,sys; print(json.loads(sys.argv[1])[sys.argv[2]])' "$line" "$1"; }
    peer=$(torch "$(field channels)" "$(field sequences)" "$(field latent)" "$(field batch)" "$(field threads)")
    "$python" - "$peer" "$line" "$mode" <<'PY'
import json, sys
peer, own = json.loads(sys.argv[1]), json.loads(sys.argv[2])
print(f"{own['sequences']} x 60 x {own['channels']}, r = {own['latent']}, batch {own['batch']}, {own['threads']} threads: "
      f"flare {own['wall_min']:.3f} s, torch {peer['torch']} {sys.argv[3]} {peer['wall_min']:.3f} s, "
      f"ratio {peer['wall_min'] / own['wall_min']:.2f} (processor time {peer['user_min'] / own['user_min']:.2f}); "
      f"products at {100 * own['product_share']:.0f} % of the peak of one core")
PY
done <<<"$lines"
