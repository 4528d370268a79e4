from setuptools import find_packages, setup

PACKAGE = "swarmabs_analysis"

setup(
    name=PACKAGE,
    version="0.1.0",
    description="Verification, replay, comparison, export, reports, figures and sweeps of swarmabs",
    maintainer="swarmabs maintainers",
    maintainer_email="maintainers@swarmabs.example",
    license="Apache-2.0",
    packages=find_packages(),
    package_data={PACKAGE: ["py.typed", "report/templates/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
    ],
    install_requires=["setuptools", "PyYAML", "jinja2", "matplotlib", "numpy", "rich"],
    extras_require={
        "parquet": ["pyarrow"],
        "sweep": ["dask", "distributed", "pyarrow"],
    },
    zip_safe=False,
)
