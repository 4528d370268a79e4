from setuptools import find_packages, setup

PACKAGE = "swarmabs_run"

setup(
    name=PACKAGE,
    version="0.1.0",
    description="Runs of swarmabs: their processes are started, watched, steered and ended; simulation in one process",
    maintainer="swarmabs maintainers",
    maintainer_email="maintainers@swarmabs.example",
    license="Apache-2.0",
    packages=find_packages(),
    package_data={PACKAGE: ["py.typed", "templates/*.j2"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
    ],
    install_requires=["setuptools", "jinja2", "numpy", "psutil"],
    zip_safe=False,
)
