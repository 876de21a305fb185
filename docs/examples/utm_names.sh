#!/bin/sh
# Writes queries.csv of the names of the pictures in the folder queries, @utm_east@utm_north@...@.jpg of VPR-datasets-downloader:
# latitude, longitude and heading are fields 6, 7 and 10. Where the names have no degrees, write file,x,y of fields 2 and 3.
echo file,lat,lon,heading > queries.csv
ls queries | sort -t@ -k14,14 -k8,8V | while read -r name; do
    echo "$name,$(echo "$name" | cut -d@ -f6,7,10 --output-delimiter=,)" >> queries.csv
done
