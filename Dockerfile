# The first flight, from a checkout (docs/start/install.md has more):
#
#     docker build -t bulletuav . && docker run --rm --user "$(id -u)" -v "$PWD:/work" bulletuav

FROM python:3.11-slim AS build
RUN apt-get update && apt-get install -y --no-install-recommends elfutils gcc libc6-dev
RUN python -m venv /opt/uv && /opt/uv/bin/pip install --no-cache-dir "uv>=0.9,<1" \
    && python -m venv --without-pip /opt/bulletuav
ENV PATH=/opt/bulletuav/bin:/opt/uv/bin:$PATH VIRTUAL_ENV=/opt/bulletuav UV_NO_CACHE=1 PYTHONDONTWRITEBYTECODE=1
WORKDIR /source

# Dependencies, with those of training; PyTorch without CUDA
COPY pyproject.toml constraints.txt ./
RUN uv pip install --torch-backend cpu -c constraints.txt -r pyproject.toml --extra sb3

# What neither flights nor trainings read: symbols, headers, tests, data of PyBullet, TensorBoard's viewer
RUN cd /opt/bulletuav/lib/python3.11/site-packages \
    && rm -rf pybullet_data pybullet_envs pybullet_examples pybullet_robots eglRenderer.*.so \
        torch/include torch/test grpc tensorboard/webfiles.zip tensorboard_data_server/bin \
    && find torch/bin -type f ! -name torch_shm_manager -delete \
    && find . -type d -name tests -prune -exec rm -rf {} + \
    && find . -type f \( -name "*.py[ix]" -o -name "*.pxd" -o -name "*.[ach]" -o -name "*.[ch]pp" \) -delete \
    && find . -name "*.so*" -type f -exec eu-strip {} +

# Machine code for processors with AVX2; any other processor compiles at its first flight
COPY . .
RUN uv pip install --no-deps -e . \
    && if [ "$(uname -m)" = x86_64 ]; then python tools/build_code.py --levels x86-64-v3; fi \
    && uv pip install --no-deps .

# Check both, and keep byte code of what a flight imports
WORKDIR /tmp
RUN bulletuav train hover --steps 2000 --out run \
    && PYTHONDONTWRITEBYTECODE= bulletuav fly crossing --drones 8 --policy straight --seed 0 --out out \
    && bulletuav verify out

# Leave out what built it, pip, and Python's editor
RUN apt-get purge -y --auto-remove elfutils gcc libc6-dev \
    && cd /usr/local/lib/python3.11 \
    && rm -rf ensurepip idlelib lib2to3 site-packages/* tkinter turtledemo ../../include \
        /source /opt/uv /tmp/* /root/.cache /var/cache/apt/* /var/lib/apt/lists/* \
    && mkdir -m 1777 /work

# As one layer: what was removed from earlier ones would count
FROM scratch
COPY --from=build / /
# Files of matplotlib and Numba go to a folder that any user may write to
ENV PATH=/opt/bulletuav/bin:/usr/local/bin:/usr/bin:/bin HOME=/tmp LANG=C.UTF-8
USER 1000
WORKDIR /work
ENTRYPOINT ["bulletuav"]
CMD ["fly", "crossing", "--drones", "8", "--policy", "straight", "--seed", "0", "--out", "out"]
