from setuptools import find_packages, setup

PACKAGE = "agent_node"

setup(
    name=PACKAGE,
    version="0.1.0",
    description="Node of one robot: turns the three broadcasts and its own state into its own command.",
    maintainer="swarmabs maintainers",
    maintainer_email="maintainers@swarmabs.example",
    license="Apache-2.0",
    packages=find_packages(),
    package_data={PACKAGE: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "agent_node = agent_node.node:main",
            "agent_node_realtime = agent_node.realtime:main",
        ],
    },
)
