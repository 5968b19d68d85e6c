# docker build -t tiegraph .
# docker run --rm -u "$(id -u):$(id -g)" -v "$PWD:/survey" tiegraph run images -o out
# With a GPU of NVIDIA: docker build --build-arg EXTRAS=[cuda12] -t tiegraph:cuda .   and   docker run --gpus all ...
FROM python:3.12-slim AS build
RUN apt-get update && apt-get install -y --no-install-recommends g++ && rm -rf /var/lib/apt/lists/*
WORKDIR /source
COPY . .
ARG EXTRAS=""
RUN python -m venv /opt/tiegraph \
    && /opt/tiegraph/bin/pip install --no-cache-dir -c packaging/constraints.txt ".${EXTRAS}" ./examples/canal

FROM python:3.12-slim
# GDAL, in the wheel of rasterio, reads XML by the system's expat
RUN apt-get update && apt-get install -y --no-install-recommends libexpat1 && rm -rf /var/lib/apt/lists/* \
    && useradd --create-home surveyor
COPY --from=build /opt/tiegraph /opt/tiegraph
ENV PATH=/opt/tiegraph/bin:$PATH HOME=/tmp
USER surveyor
WORKDIR /survey
ENTRYPOINT ["tiegraph"]
