#!/bin/sh
# Run by a farm before a job: checks the files that it would read, a path a line in the
# list, and lets the job start (0) or names the reason why not.
#   sh farm.sh files.txt report.json
list=$1 report=$2

animtool validate - --jobs 2 --format json --output-file "$report" < "$list"
case $? in
  0) exit 0 ;;
  1) echo "animtool: errors in the files of this job, see $report" >&2; exit 1 ;;
  3) echo "animtool: a file of this job cannot be read, see $report" >&2; exit 1 ;;
  5) exit 0 ;; # The job has no file that animtool checks.
  *) echo "animtool: could not be run" >&2; exit 2 ;;
esac
