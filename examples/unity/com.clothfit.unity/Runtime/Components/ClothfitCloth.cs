using System;
using System.Collections.Generic;
using UnityEngine;

namespace Clothfit
{
    /// <summary>What a fit has found of a cloth, in the order of its vertices and springs. Empty: not fitted.</summary>
    [Serializable]
    public class FittedValues
    {
        public List<float> masses = new List<float>(); // n, kg
        public List<float> stiffnesses = new List<float>(); // S, N/m
        public List<float> restLengths = new List<float>(); // S, m
        public List<Vector3> velocities = new List<Vector3>(); // n, m/s
        public bool moved; // whether pinOffset counts
        public Vector3 pinOffset; // m

        public bool Any
        {
            get { return masses.Count + stiffnesses.Count + restLengths.Count + velocities.Count > 0 || moved; }
        }
    }

    /// <summary>A cloth: the vertices and triangles of the mesh beside it, as masses and springs.</summary>
    [AddComponentMenu("Clothfit/Cloth")]
    [RequireComponent(typeof(MeshFilter))]
    [DisallowMultipleComponent]
    public class ClothfitCloth : MonoBehaviour
    {
        [Header("Material")]
        [Tooltip("Mass of a square metre, kg/m²")]
        [Min(1e-6f)]
        public float density = 0.1f;

        [Tooltip("Stiffness of the cloth, N/m, from which those of the springs come")]
        [Min(0f)]
        public float stiffness = 50f;

        [Tooltip("Whether springs across the edges resist bending")]
        public bool bendingSprings = true;

        [Tooltip("Damping of vertices (1/s) and springs (s)")]
        [Min(0f)]
        public float damping = 0.1f;

        [Tooltip("Drag of the air, kg/(m⁶ s): acts with the cube of a triangle's area")]
        [Min(0f)]
        public float drag = 0.1f;

        [Tooltip("Velocity at the start, m/s")]
        public Vector3 velocity;

        [Tooltip("Direction of the warp in the axes of this object; 0: the mesh shows it. Only families of springs need it")]
        public Vector3 warp;

        [Header("Fit")]
        [Tooltip("How to fit the masses")]
        public FittedMany fitMass = FittedMany.No;

        [Tooltip("How to fit the stiffnesses of the springs")]
        public FittedMany fitStiffness = FittedMany.Each;

        [Tooltip("How to fit the rest lengths of the springs")]
        public FittedMany fitRestLength = FittedMany.No;

        [Tooltip("How to fit the velocity at the start")]
        public Fitted fitVelocity = Fitted.No;

        [Tooltip("Fit the damping")]
        public bool fitDamping;

        [Tooltip("Fit the drag of the air")]
        public bool fitDrag;

        [Tooltip("Fit the places of the keys of the fixers that hold this cloth")]
        public bool fitPaths;

        [Tooltip("Fit one vector by which all moving fixers hold the cloth elsewhere")]
        public bool fitPinOffset;

        [Tooltip("Lowest and highest values for this cloth, in place of those of the scene")]
        public List<FitBounds> bounds = new List<FitBounds>();

        [Header("View")]
        [Tooltip("Whether the springs are drawn while this object is selected: blue soft, red stiff, grey those of equal "
            + "stiffness")]
        public bool showSprings = true;

        [HideInInspector]
        public FittedValues fitted = new FittedValues();

        /// <summary>The mesh as vertices and triangles of the cloth. Throws InvalidOperationException where there is none.</summary>
        public Weld Weld()
        {
            var filter = GetComponent<MeshFilter>();
            Mesh mesh = filter == null ? null : filter.sharedMesh;
            var mover = GetComponent<ClothfitMover>();
            if (mover != null && mover.Original != null) mesh = mover.Original; // of before it was moved
            if (mesh == null) throw new InvalidOperationException(name + ": the cloth has no mesh");
            return new Weld(mesh);
        }

        /// <summary>Forgets what fits have found.</summary>
        [ContextMenu("Forget fitted values")]
        public void ForgetFitted()
        {
            fitted = new FittedValues();
        }

        void OnDrawGizmosSelected()
        {
            if (!showSprings) return;
            try
            {
                ObjectData data = SceneBuilder.Object(this);
                SpringColours.Draw(data.vertPos, data.springs, data.springStiffness);
            }
            catch (Exception error) when (error is InvalidOperationException || error is ArgumentException)
            {
                // a mesh of which no cloth can be made is drawn without springs; the export says why
            }
        }
    }
}
