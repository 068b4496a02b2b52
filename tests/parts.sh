# For scripts that have parts: `part NAME` begins one and ends the one before, `spent` prints the processor time of each.
# Processes in the background count in the part that waits for them.

parts_name=
parts_before=0
parts_list=

part() {
    # Not in a process of its own, which would have started none.
    times >"${TMPDIR:-/tmp}/parts.$$"
    parts_now=$(sed -n '2s/m/ /gp' "${TMPDIR:-/tmp}/parts.$$" | tr -d s | awk '{ printf "%d", 60 * $1 + $2 + 60 * $3 + $4 }')
    rm -f "${TMPDIR:-/tmp}/parts.$$"
    if [ -n "$parts_name" ]; then
        parts_list="$parts_list$((parts_now - parts_before)) s: $parts_name
"
    fi
    parts_name=$1
    parts_before=$parts_now
    echo "== $1"
}

spent() {
    echo "Processor time by part:"
    printf '%s' "$parts_list"
    echo "$parts_now s in all"
}
