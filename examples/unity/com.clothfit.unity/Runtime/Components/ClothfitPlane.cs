using UnityEngine;

namespace Clothfit
{
    /// <summary>Makes a rectangle for a cloth and keeps it up to date.</summary>
    [AddComponentMenu("Clothfit/Plane")]
    [RequireComponent(typeof(MeshFilter))]
    [DisallowMultipleComponent]
    public class ClothfitPlane : MonoBehaviour
    {
        const int Most = 500;

        [Tooltip("The longer side has as many vertices and two more")]
        [Range(0, Most)]
        public int divisions = 10;

        [Tooltip("Length along x, m")]
        [Min(1e-3f)]
        public float width = 2f;

        [Tooltip("Length along z, m")]
        [Min(1e-3f)]
        public float length = 2f;

        Mesh made;

        /// <summary>Makes the mesh anew and gives it to the mesh filter.</summary>
        [ContextMenu("Make the mesh")]
        public void Make()
        {
            Mesh before = made;
            made = PlaneMesh.Make(Mathf.Clamp(divisions, 0, Most), width, length);
            GetComponent<MeshFilter>().sharedMesh = made;
            if (before == null) return;
            if (Application.isPlaying) Destroy(before);
            else DestroyImmediate(before);
        }

        void Reset()
        {
            Make();
        }

        void Awake()
        {
            if (GetComponent<MeshFilter>().sharedMesh == null) Make();
        }
    }
}
