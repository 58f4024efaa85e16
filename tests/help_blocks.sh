#!/bin/bash
# Prints a document with the output of each `$ PROGRAM --help` block as the programs in FOLDER print it now:
# `bash tests/help_blocks.sh docs/programs.md build` should differ in nothing from the document.
[ $# = 2 ] && [ -f "$1" ] && [ -d "$2" ] || { echo "usage: help_blocks.sh DOCUMENT FOLDER" >&2; exit 2; }
skip=0
while IFS= read -r line || [ -n "$line" ]; do
    case $line in
    '```') skip=0 ;;
    '$ '*' --help')
        echo "$line"
        command=${line#\$ }
        "$2/"${command} 2>&1 # words of it: a program, perhaps a command of it, --help
        skip=1 ;;
    esac
    [ $skip = 1 ] || printf '%s\n' "$line"
done < "$1"
