#!/bin/sh
# Remove from an environment what Lookback does not need when it runs: trim.sh ENVIRONMENT. For the Debian package and
# the container, where nothing is installed later: pip, setuptools, tests of numpy, tools of ONNX Runtime that make models,
# and of pymavlink all but one of its 88 dialects, and lxml, by which it makes dialects.
set -eu
site=$(echo "$1"/lib/python3*/site-packages)
rm -rf "$site"/pip "$site"/pip-*.dist-info "$site"/setuptools "$site"/setuptools-*.dist-info "$site"/pkg_resources \
    "$site"/_distutils_hack "$site"/distutils-precedence.pth
rm -rf "$site"/lxml "$site"/lxml-*.dist-info "$site"/numpy/*/tests "$site"/numpy/tests
# Where onnx is installed, by the extra `model`, they quantize.
[ -d "$site/onnx" ] || rm -rf "$site"/onnxruntime/transformers "$site"/onnxruntime/tools "$site"/onnxruntime/quantization
find "$1/bin" -mindepth 1 ! -name 'python*' ! -name lookback -delete
mavlink=$site/pymavlink
[ -d "$mavlink" ] || exit 0
rm -rf "$mavlink/generator" "$mavlink/tools" "$mavlink/dialects/__pycache__"
# v10 as well: pymavlink's reader of logs imports it.
find "$mavlink"/dialects/v*/ -type f ! -name '__init__*' ! -name 'ardupilotmega.py' ! -name 'ardupilotmega.*.pyc' -delete
